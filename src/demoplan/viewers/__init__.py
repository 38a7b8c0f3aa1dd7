"""What people look at: an episode in rerun, and a report in one HTML file.

Tables become plain view values (``sources``, ``compose``, ``scene``, ``lanes``, ``describe``), which one
adapter per medium draws: ``rerun_adapter`` for recordings, ``report`` for the page.
"""
