"""The command line: reads arguments, calls the pipeline, prints results; nothing else prints or exits."""

import os

# Tables come and go in quick succession: what polars' allocator frees is soon wanted again. It reads this
# once, as polars is imported, so that it must stand before other imports; a setting of the user's own wins.
os.environ.setdefault("_RJEM_MALLOC_CONF", "dirty_decay_ms:10000,muzzy_decay_ms:10000")

from demoplan.cli.main import main

__all__ = ["main"]
