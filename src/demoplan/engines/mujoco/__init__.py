"""Physics: scenes in MuJoCo, and participants who demonstrate tasks in them.

``scene`` builds a table with cubes and says what rests on what; ``hands`` adds a hand that follows a
commanded pose; ``motion`` gives minimum-jerk paths; ``participants`` draws who demonstrates;
``demonstration`` lets them act; ``labels`` says what they did; ``sensing`` is what a rig saw of it.
"""
