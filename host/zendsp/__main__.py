"""``python -m zendsp``: the same as the command ``zendsp``."""

from zendsp.cli import main

if __name__ == "__main__":
    main()
