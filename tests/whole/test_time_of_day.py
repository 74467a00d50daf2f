"""The time of day may be set at any moment, by years. Nothing waits by it, measures by it, or puts
in order by it what matters: that is for the monotonic clocks.
"""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ("host/zendsp", "target/zendsp_target", "protocol/zendsp_protocol", "c_isr/zendsp_isr")
# what tells it in Python and C, and what waits by it
_TELLS = {
    ".py": re.compile(
        r"\btime\.(?:time|time_ns|strftime|localtime|gmtime|ctime|asctime)\("
        r"|\bfrom time import|\.(?:now|today|utcnow)\(|st_[acm]time|get[acm]time\("
        r"|CLOCK_REALTIME|\butime\("
    ),
    ".c": re.compile(
        r"CLOCK_REALTIME|CLOCK_TAI|\b(?:gettimeofday|time|timespec_get|ftime|sem_timedwait"
        r"|pthread_cond_timedwait|pthread_mutex_timedlock|mq_timedreceive|timerfd_create)\("
    ),
}
_TELLS[".h"] = _TELLS[".c"]
# how often, and what for
MAY = {
    "host/zendsp/bridge/foxglove.py": (2, "stamps for a viewer, which begin again or run on"),
    "host/zendsp/cli/salvage.py": (2, "shown"),
    "host/zendsp/lab_keys.py": (5, "certificates are good until a day"),
    "host/zendsp/link/metadata.py": (1, "kept in the recording"),
    "host/zendsp/one_writer.py": (1, "shown: since when somebody writes into a folder"),
    "host/zendsp/physics/model.py": (1, "whether a file is another one: equal or not"),
    "host/zendsp/physics/robots/mjcf.py": (1, "whether a file is another one: equal or not"),
    "host/zendsp/physics/robots/robot.py": (1, "whether a file is another one: equal or not"),
    "host/zendsp/physics/simulation/run.py": (2, "kept in the recording"),
    "host/zendsp/proof/page.py": (1, "shown"),
    "host/zendsp/tui/diagnoses.py": (3, "shown, and in the name of a folder that is free"),
    "host/zendsp/tui/events.py": (1, "shown"),
    "host/zendsp/tui/panels/events.py": (2, "shown"),
    "host/zendsp/tui/runs.py": (3, "shown, and in the name of a folder that is free"),
    "host/zendsp/tui/screens/console_variables.py": (4, "the order of a list to choose from"),
    "host/zendsp/tui/screens/diagnose.py": (1, "shown"),
    "host/zendsp/tui/screens/diagnose_given.py": (2, "shown"),
    "host/zendsp/tui/screens/execute_measure.py": (1, "in the name of a file that is free"),
    "host/zendsp/tui/screens/execute_runs.py": (2, "shown"),
    "host/zendsp/tui/statusbar.py": (1, "shown"),
    "host/zendsp/tui/workspace.py": (3, "the order of a list to choose from"),
    "protocol/zendsp_protocol/certificates.py": (5, "whether one is good, as TLS judges it"),
    "protocol/zendsp_protocol/stop_page.py": (1, "shown: when somebody asked for STOP"),
    "target/zendsp_target/access/lists.py": (2, "whether a file is another one: equal or not"),
    "target/zendsp_target/runtime/variables/updates.py": (1, "shown: the log, which has ticks"),
    "target/zendsp_target/serving/service.py": (2, "shown: since when a target is there"),
    "c_isr/zendsp_isr/build.py": (4, "what is dropped first; what is in use is locked"),
}


def test_the_time_of_day_is_told_where_it_does_no_harm_and_nowhere_else() -> None:
    """A new use is a question: does anything wait, measure or decide by it? If not, it goes into
    the list, with what it is for.
    """
    found = {}
    for folder in SOURCES:
        for path in sorted((ROOT / folder).rglob("*")):
            tells = _TELLS.get(path.suffix)
            if tells is not None and (count := len(tells.findall(path.read_text()))):
                found[str(path.relative_to(ROOT))] = count
    assert found == {name: count for name, (count, _) in MAY.items()}
