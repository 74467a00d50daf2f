"""What ``zendsp demo`` shows: one story per module, each a function that talks while it runs."""

from zendsp.demo.live_loop import run_live_loop

__all__ = ["run_live_loop"]
