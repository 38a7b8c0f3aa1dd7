"""Prefect flows over demoplan: they arrange calls and hold no logic; nothing imports them."""

import os

# Before Prefect or Ray are imported: neither they nor their servers may report to anybody.
os.environ.setdefault("DO_NOT_TRACK", "1")
os.environ.setdefault("PREFECT_SERVER_ANALYTICS_ENABLED", "false")
os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
