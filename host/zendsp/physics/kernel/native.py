"""Builds the C of the kernel, the filters and all effects, and opens it through cffi."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import platform
import re
import subprocess
import tempfile
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import cffi
import numpy as np
import numpy.typing as npt

from zendsp.errors import ZendspError
from zendsp.physics.effects import Effect, library
from zendsp_isr.build import cache_root
from zendsp_isr.compiler import find_compiler

Array = npt.NDArray[np.float64]

FAST = (
    "-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros",
    "-ffp-contract=fast", "-shared", "-fPIC",
    # nothing that an effect needs is worked out where no model has the effect
    "-fno-tree-loop-im",
    # lanes are copied as they are worked with: a copy by memcpy is written in other pieces than it
    # is read, and what reads it waits until all of them have reached the cache
    "-fno-tree-loop-distribute-patterns",
    # a third of the compilation, and no step is faster for it
    "-fno-gcse", "-fno-gcse-after-reload",
)  # fmt: skip
# all lanes in one register, where there is one so wide
WIDE = ("-mprefer-vector-width=512",) if platform.machine() == "x86_64" else ()
FLAGS = (*FAST, *WIDE, "-std=c11", "-fopenmp-simd")

CDEF = """
typedef struct {
    int n; int sub; int stiff; double T; const double *ucum; double delay; double gain; double limit;
    const double *m; double shift; const double *half; const double *k1; const double *k2; const double *w;
    const double *inertia; const double *bias; const double *bias_slope; double reference; double gravity; const double *other; const double *temperature;
    const double *extra;
    int nfx; const int *kind; const double *p; double q0; double qd0; double a0; double unbent; double b0; double bd0; int load_sensor; int beyond; int reset;
    const double *rq; const double *rqd; const double *rb; const double *rbd; double t0;
    double kp; double kd; const double *ref; double resolution; double *uloop;
} zk_model;
int zk_run(const zk_model *M, double *r, double *xq, double *xqd, double *torque);
int zk_run_lanes(const zk_model *M, double *r);
void zk_trace(const zk_model *M, const double *motion, const double *u, double v0, double *out);
void zk_sense(const zk_model *M, const double *q, double *out);
void zk_filter(int n, double T, const double *k1, const double *k2, const double *w, const double *active,
               const double *inertia, const double *damp, int cols, const void *d, int single, int meas,
               const double *per, int lag, const int *rows, int wanted, double *out);
void zk_filter_back(int n, double T, const double *k1, const double *k2, const double *w,
                    const double *inertia, const double *damp, const double *r, double *g);
void zf_gains(int n, double T, const double *sa, const double *R, double *k1, double *k2, double *w);
double zf_smooth(int n, double T, double sd, double sd0, const double *a_in, const double *m, const double *half, const double *R,
                 double q0, double v0, double *work, double *out, double *var);
void zf_swing(int n, double T, double first, double second, const double *a, double *place);
typedef struct {
    int n; int d; int c; int m; int s; int every; double T; const double *A; const double *G;
    const double *eased; const double *bent; const int *motor; const int *link;
    const double *f; const double *s2;
    const double *value; const double *half; const double *R; const int *at; const double *x0; const double *p0;
} zf_chain;
double zf_smooth_chain(const zf_chain *C, double *work, double *out);
"""  # noqa: E501

LANES = 8  # parameter sets that ``zk_run_lanes`` takes at once

_PARTS = ("effects.c", "motion.c", "step.c", "observer.c")  # each stands on those before it

_PLACES = {  # of an effect: the mark in effects.c, and what is done there for each lane
    "torque": ("FORCE", "EACH (*torque)[l] += OF(fx_{name})(p, S, l);"),
    "load": (
        "FORCE",
        "if (!N->two_mass || stride) EACH (*torque)[l] += OF(fx_{name})(p, S, l);",
    ),
    "viscous": ("FORCE", "EACH visc[l] += OF(fx_{name})(p, S, l);"),
    "scale": (
        "FORCE",
        "EACH {{ const double c = OF(fx_{name})(p, S, l); (*scale)[l] *= c; (*thick)[l] *= c; }}",
    ),
    "dry_scale": ("FORCE", "EACH (*scale)[l] *= OF(fx_{name})(p, S, l);"),
    "drive": (
        "FORCE",
        (
            "EACH {{ const double c = OF(fx_{name})(p, S, l, S->tau[l]);"
            " (*torque)[l] += S->tau[l] - c; S->tau[l] = c; }}"
        ),
    ),
    "dry": ("DRY", "EACH (*level)[l] += OF(fx_{name})(p, S, l, (*v)[l] > 0 ? 1 : -1);"),
    "actuator": ("ACTUATOR", "EACH u[l] = OF(fx_{name})(p, S, l, u[l]);"),
    "sensor": ("SENSOR", "EACH (*out)[l] += OF(fx_{name})(p, S, l);"),
    "setup": ("SETUP", "{c}"),
}
# what is fetched where an effect's C names it
_LOOKS = {r"\boqd*\b": "LOOK_AT((int)p[0]) ", r"\btemp\b": "FEEL "}
_ALSO = {  # what else is done where a model has one
    "drive": [("SETUP", "drives = 1;")],
    "sensor": [("SETUP", "senses = 1;")],
    "load": [("SETUP", "hung = 1;"), ("LOAD", "EACH (*fall)[l] += OF(fx_{name})(p, S, l);")],
}
_MOVES = re.compile(r"\b(qd|qdd|u|tau|load)\b")  # within a step; the rest is worked out once
_MORE = {"dry": ", int dir", "actuator": ", double u", "drive": ", double tau"}

_POWER = re.compile(r"\bpow\((fabs\([^()]*\)[^(),]*), p\[(\d)\]\)")  # of what is not negative


def source_text(effects: dict[str, Effect]) -> str:
    """The complete C source for a library of effects; the index of an effect is its place in the
    mapping.
    """
    functions: list[str] = []
    marks = ("LOAD", "STILL", "PLACES", *dict(_PLACES.values()))
    cases: dict[str, list[str]] = {mark: [] for mark in marks}
    for i, effect in enumerate(effects.values()):
        if effect.site == "body":
            continue
        if effect.site not in _PLACES:
            raise ZendspError(f"effect {effect.name!r}: unknown site {effect.site!r}")
        looks = "".join(look for name, look in _LOOKS.items() if re.search(name, effect.c))
        places = []
        for mark, done in (_PLACES[effect.site], *_ALSO.get(effect.site, ())):
            looked = looks if mark != "SETUP" else ""
            text = _by_power(done.format(name=effect.name, c=effect.c), effect)
            still = effect.site not in ("viscous", "drive") and not _MOVES.search(effect.c)
            place = "STILL" if mark == "FORCE" and still else mark
            cases[place].append(f"case {i}: {looked}{text} break;")
            places += [f"1 << {place}"] if mark != "SETUP" else []
        cases["PLACES"].append(f"case {i}: places = {' | '.join(places) or '0'}; break;")
        if effect.site == "viscous":
            slopes = [k for k, p in enumerate(effect.parameters) if p.size == "torque/speed"]
            most = "".join(f"fmax(p[{k}], " for k in slopes) + "0" + ")" * len(slopes)
            cases["SETUP"].append(f"case {i}: damp += {most}; break;")
        if effect.site == "setup":
            continue
        if re.search(r"\bload\b", effect.c):
            cases["SETUP"].append(f"case {i}: loaded = 1; break;")
        more = _MORE.get(effect.site, "") + (", int whole" if _POWER.search(effect.c) else "")
        head = f"(const double *p, const OF(state) *s, int l{more})"
        functions.append(
            f"INLINE double OF(fx_{effect.name}){head} {{ {_of_lane(effect)} }}"
        )
    folder = resources.files("zendsp.physics.kernel")
    observer = "".join((folder / name).read_text() for name in _PARTS)
    for mark, lines in cases.items():
        observer = observer.replace(f"/* EFFECT_CASES_{mark} */", "\n".join(lines))
    observer = observer.replace("/* EFFECT_FUNCTIONS */", "\n".join(functions))
    kernel = (folder / "kernel.c").read_text().replace("/* OBSERVER */", observer)
    smoothers = "".join((folder / name).read_text() for name in ("filter.c", "chain.c"))
    return f"#define MANY {LANES}\n" + kernel + smoothers


def _by_power(call: str, effect: Effect) -> str:
    """The call of an effect, three times where it has a power: a square needs no logarithm."""
    power = _POWER.search(effect.c)
    if not power or "OF(fx_" not in call:
        return call
    one, two, any_other = (f"{call.removesuffix(');')}, {whole});" for whole in (1, 2, 0))
    whole = f"N->whole[i][{power[2]}]"
    return f"if ({whole} == 2) {two} else if ({whole} == 1) {one} else {any_other}"


def _of_lane(effect: Effect) -> str:
    """The C of an effect with its parameters and its state taken from lane l."""
    other = re.search(r"\bp\b(?!\s*\[)|\bs\b(?!\s*->)", effect.c)
    if other:
        raise ZendspError(
            f"effect {effect.name!r}: {other[0]!r} stands alone in {effect.c!r}; write p[0], p[1],"
            " … and s->q, s->qd, s->qdd, s->t, s->temp, s->u, s->tau, s->load"
        )
    powers = _POWER.sub(r"raised(\1, p[\2], whole)", effect.c)
    body = re.sub(r"\bp\s*\[([^\]]+)\]", r"p[(\1) * LANES + l]", powers)
    return re.sub(r"\bs\s*->\s*(q|qd|qdd|u|tau|load|t|temp|oq|oqd|oqdd)\b", r"s->\1[l]", body)


def _machine() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(
            (line for line in lines if line.startswith(("flags", "Features"))), platform.processor()
        )
    except OSError:
        return platform.machine()


def build(source: str, flags: tuple[str, ...] = FLAGS) -> Path:
    """Compile C source to a shared object, cached by content, compiler and CPU.

    Parameters
    ----------
    source : str
        C source.
    flags : tuple of str
        Compiler flags.

    Returns
    -------
    Path
        The shared object.

    Raises
    ------
    ZendspError
        With the compiler's words where it refuses.
    CompileFailed
        There is no compiler; the message says what to install.
    """
    compiler = find_compiler().command
    key = hashlib.sha256(
        "\0".join([source, *flags, *compiler, _machine(), platform.machine()]).encode()
    ).hexdigest()[:24]
    target = cache_root() / f"physics-{key}.so"
    if target.exists():
        return target
    with _alone(target.parent), tempfile.TemporaryDirectory(dir=target.parent) as folder:
        if target.exists():  # another process has built it meanwhile
            return target
        code, out = Path(folder) / "physics.c", Path(folder) / "physics.so"
        code.write_text(source)
        run = subprocess.run(
            [*compiler, *flags, str(code), "-o", str(out), "-lm"],
            capture_output=True,
            text=True,
            check=False,
        )
        if run.returncode:
            raise ZendspError(f"the C compiler refused the physics kernel:\n{run.stderr[-4000:]}")
        out.replace(target)  # atomic: where there are no locks, several processes build at once
    return target


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """One process at a time: the kernel takes a compiler 20 to 30 s."""
    place = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(place, fcntl.LOCK_EX)
        yield
    finally:
        os.close(place)


class Native:
    """The opened library; one per set of effects."""

    def __init__(self, effects: dict[str, Effect]) -> None:
        self.ffi: Any = cffi.FFI()
        self.ffi.cdef(CDEF)
        self.lib: Any = self.ffi.dlopen(str(build(source_text(effects))))
        self._doubles = self.ffi.typeof("double[]")
        self.index = {name: i for i, name in enumerate(effects)}

    def doubles(self, array: Any) -> Any:
        """Pointer to a C-contiguous float64 array, which must outlive the call."""
        return self.ffi.from_buffer(self._doubles, array)


_opened: dict[tuple[str, ...], Native] = {}
_latest: list[tuple[dict[str, Effect], Native]] = []  # asked for thousands of times


def native() -> Native:
    """The library for the present set of effects, compiled at first use."""
    effects = library()
    for known, opened in _latest:
        if known is effects:
            return opened
    key = tuple(effects)
    if key not in _opened:
        _opened[key] = Native(effects)
    _latest[:] = [(effects, _opened[key])]
    return _opened[key]


def swung(a: Array, sample_time: float, first: float, second: float) -> Array:
    """Place of what hangs on a joint and swings when it is accelerated, (n,): first place[k-1] +
    second place[k-2] + T² a[k-1].
    """
    lib, place = native(), np.empty(len(a))
    motion = np.ascontiguousarray(a)
    lib.lib.zf_swing(len(a), sample_time, first, second, lib.doubles(motion), lib.doubles(place))
    return place
