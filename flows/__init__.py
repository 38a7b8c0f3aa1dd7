"""Prefect flows over demoplan: they arrange calls and hold no logic; nothing imports them."""

import os

# Before Prefect is imported: neither its client nor its embedded server may report to anybody.
os.environ.setdefault("DO_NOT_TRACK", "1")
os.environ.setdefault("PREFECT_SERVER_ANALYTICS_ENABLED", "false")
