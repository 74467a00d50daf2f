"""The command ``zendsp``, also as ``python -m zendsp``: Ctrl-C while it loads ends it quietly."""

from __future__ import annotations


def main() -> None:
    """Import the commands and run the one that was typed."""
    try:
        from zendsp.cli import main as command
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    command()


if __name__ == "__main__":
    main()
