"""``python -m demoplan`` is the ``demoplan`` command."""

from demoplan.cli import main

if __name__ == "__main__":
    main()
