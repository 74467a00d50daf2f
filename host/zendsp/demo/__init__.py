"""What ``zendsp demo`` shows: a machine conceals physics, the diagnosis finds it over the link, and
the running program compensates it.
"""

from zendsp.demo.run import run_demo
from zendsp.demo.stage import Stage, get_stage
from zendsp.demo.story import Told, tell_story

__all__ = ["Stage", "Told", "get_stage", "run_demo", "tell_story"]
