"""Builds the simulator's C, completed with the library of effects, and opens it through cffi."""

from __future__ import annotations

from importlib import resources
from typing import Any

import cffi

from zendsp.errors import ZendspError
from zendsp.physics.effects import Effect, library
from zendsp.physics.kernel.native import FAST, build

_PARTS = ("tree.h", "state.h", "solve.h", "effects.h", "step.h", "simulate.c")
MAX_JOINTS, MAX_PARAMETERS, TREE_ROW = 8, 6, 28

_CASES = {
    "torque": "case {i}: {{ zs o = s; {look} f->smooth += fx_{name}(p, &o); break; }}",
    "load": "case {i}: {{ zs o = s; o.q = x[joint]; f->load += fx_{name}(p, &o); break; }}",
    "viscous": "case {i}: visc += fx_{name}(p, &w); break;",
    "dry": (
        "case {i}: f->dry_pos += fx_{name}(p, &s, 1); f->dry_neg += fx_{name}(p, &s, -1); break;"
    ),
    "scale": (
        "case {i}: {{ const double c = fx_{name}(p, &s); dry_scale *= c; visc_scale *= c; break; }}"
    ),
    "dry_scale": "case {i}: dry_scale *= fx_{name}(p, &s); break;",
    "drive": (
        "case {i}: {{ const double c = fx_{name}(p, &s, s.tau); f->smooth += s.tau - c; s.tau ="
        " w.tau = c; break; }}"
    ),
}
_LOOK = "{ const int k = S->j[(int)p[0]].motor; o.oq = x[k]; o.oqd = v[k]; o.oqdd = 0; }"
_ACROSS = "case {i}: if ((int)p[1] == 0) S->across[joint][(int)p[0]] += p[2]; break;"
_HEADS = {
    "dry": "(const double *p, const zs *s, int dir)",
    "actuator": "(const double *p, const zs *s, double u)",
    "drive": "(const double *p, const zs *s, double tau)",
}
_FLAGS = (*FAST, "-std=gnu11", "-D_GNU_SOURCE")  # dl_iterate_phdr, of declared.h

CDEF = """
typedef struct {
    int32_t joints, kind, inner, load_sensor, hold, effects;
    double period, delay, p1, p2, p3, p3_angle, gravity[3];
    double inertia[8], weight[8], gain[8], limit[8], resolution[8];
    double command_matrix[64], sensor_matrix[64], sensor_offset[8], q0[8], qd0[8];
    const double *tree; const int32_t *effect, *effect_joint; const double *effect_p;
    const double *temperature; int32_t temperatures, reserved;
} sim_config;
typedef struct sim sim;
sim *sim_new(const sim_config *c, int room);
void sim_free(sim *S);
void sim_truth(const sim *S, double *q, double *qd, double *torque);
double sim_column_late(const sim *S, int joint);
void sim_measure(const sim *S, double *measured, int32_t *counts);
int sim_advance(sim *S, const double *command);
int sim_loop(sim *S, int rows, const double *r, const double *ff, const double *kp, const double *kd, const double *ki,
             double cutoff, const double *most, double *measured, double *command, double *q, double *qd, double *torque);
void sim_tree(int n, const double *tree, const double *gravity, const double *q, const double *qd, const double *qdd,
              double *tau, double *mass);

typedef struct { char name[64], unit[32], text[192]; void *address; double minimum, maximum; int32_t kind, type, length, columns; } host_variable;
typedef struct { const void *address; int32_t type, pad; } host_channel;
typedef struct {
    struct { uint64_t tick; double t, period; int32_t joints, enabled; uint32_t din, dout; int32_t enc[8]; double adc[8], aout[8];
             double counts_per_unit[8], zero_counts[8], mv_per_torque[8];
             double torque_max[8], inertia[8]; int32_t first, outside;
             void *declare; void *acquire; } io;
    double measured[8], q[8], qd[8], torque[8];
    double tick, t, enc[8];
    int32_t variables, stored;
    host_variable variable[512];
    char problem[256];
    void *isr, *background;
    const host_channel *channel; int32_t channels, rows; double *out;
    double low_q[8], high_q[8], most_aout[8]; int32_t beyond[8];
} host;
typedef struct { const double *data; int32_t rows, columns; uint32_t version; } isr_table;
int host_size(void);
host *host_open(const char *path, int joints, double period, const double *counts_per_unit, const double *mv_per_torque,
                const double *torque_max, const double *inertia);
int host_run(host *h, sim *S, int ticks, int decimation, int background, const host_channel *channel, int channels, double *out,
             volatile int32_t *progress);
"""  # noqa: E501

_TREE_ENTRY = """
void sim_tree(int n, const double *tree, const double *gravity, const double *q, const double *qd, const double *qdd,
              double *tau, double *mass) {
    tree_pose pose;
    tree_place(n, tree, q, &pose);
    tree_torque(n, tree, &pose, gravity, qd, qdd, tau);
    tree_mass(n, tree, &pose, mass);
}
"""  # noqa: E501


def source_text(effects: dict[str, Effect]) -> str:
    """The complete C source for a library of effects; the index of an effect is its place in the
    mapping.

    Raises
    ------
    ZendspError
        An effect whose site is unknown.
    """
    parts: dict[str, list[str]] = {
        "FUNCTIONS": [], "FORCE": [], "ACTUATOR": [], "SENSOR": [], "SETUP": [], "ACROSS": [],
    }
    for i, effect in enumerate(effects.values()):
        if effect.site == "body":
            continue
        if effect.site == "setup":
            parts["SETUP"].append(f"case {i}: {effect.c} break;")
            continue
        head = _HEADS.get(effect.site, "(const double *p, const zs *s)")
        unused = "(void)p; (void)s; " + ("(void)dir; " if effect.site == "dry" else "")
        parts["FUNCTIONS"].append(
            f"static inline double fx_{effect.name}{head} {{ {unused}{effect.c} }}"
        )
        if effect.site in _CASES:
            coupled = effect.coupled
            parts["FORCE"].append(
                _CASES[effect.site].format(i=i, name=effect.name, look=_LOOK if coupled else "")
            )
            if coupled:
                parts["ACROSS"].append(_ACROSS.format(i=i))
        elif effect.site == "actuator":
            parts["ACTUATOR"].append(f"case {i}: u = fx_{effect.name}(p, &s, u); break;")
        elif effect.site == "sensor":
            parts["SENSOR"].append(f"case {i}: out += fx_{effect.name}(p, &s); break;")
        else:
            raise ZendspError(f"effect {effect.name!r}: unknown site {effect.site!r}")
    text = "".join(map(_read, _PARTS))
    for name, lines in parts.items():
        mark = "EFFECT_FUNCTIONS" if name == "FUNCTIONS" else f"EFFECT_CASES_{name}"
        text = text.replace(f"/* {mark} */", "\n".join(lines))
    root = resources.files("zendsp_isr")
    isr = root.joinpath("include", "isr.h").read_text(encoding="utf-8")
    declared = root.joinpath("runtime", "declared.h").read_text(encoding="utf-8")
    host = _read("program.c")
    for name, header in (("declared.h", declared), ("isr.h", isr)):
        host = host.replace(f'#include "{name}"', header)
    return text + _TREE_ENTRY + host


def _read(name: str) -> str:
    return resources.files("zendsp.physics.simulation").joinpath(name).read_text(encoding="utf-8")


class SimulatorLibrary:
    """The opened simulator; one per set of effects."""

    def __init__(self, effects: dict[str, Effect]) -> None:
        self.ffi: Any = cffi.FFI()
        self.ffi.cdef(CDEF)
        self.lib: Any = self.ffi.dlopen(str(build(source_text(effects), _FLAGS)))
        if self.lib.host_size() != self.ffi.sizeof("host"):
            raise ZendspError(
                "the simulator's C and its declaration in Python differ in the layout of 'host'"
            )
        self.index = {name: i for i, name in enumerate(effects)}

    def doubles(self, array: Any) -> Any:
        """Pointer to a C-contiguous float64 array, which must outlive the call."""
        return self.ffi.cast("double *", self.ffi.from_buffer(array))

    def ints(self, array: Any) -> Any:
        """Pointer to a C-contiguous int32 array, which must outlive the call."""
        return self.ffi.cast("int32_t *", self.ffi.from_buffer(array))


_opened: dict[tuple[str, ...], SimulatorLibrary] = {}


def simulator_library() -> SimulatorLibrary:
    """The library for the present set of effects, compiled at first use."""
    effects = library()
    key = tuple(effects)
    if key not in _opened:
        _opened[key] = SimulatorLibrary(effects)
    return _opened[key]
