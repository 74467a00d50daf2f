/* concealed_spec.h: the list of concealed effects, read from the lines that a machine is opened
 * with.
 *
 *     effect1 = coulomb joint=1 level=2.0
 *     effect2 = ripple joint=2 order=8 amplitude=0.5 phase=0.3
 *
 * One line an effect, numbered from 1 without gaps; names and units of the parameters are those of
 * the effects table in docs/machines_simulated.md. zendsp_target.concealed.sealed writes these
 * lines; nobody else needs to.
 */
#ifndef ZENDSP_CONCEALED_SPEC_H
#define ZENDSP_CONCEALED_SPEC_H

#include <stdio.h>  /* snprintf */
#include <stdlib.h> /* strtod */
#include <string.h> /* strcmp, strchr */

#include "machine_config.h"

enum { CONCEALED_EFFECTS = 16, CONCEALED_PARAMETERS = 4, CONCEALED_WORD = 64 };

typedef enum concealed_kind {
    VISCOUS,
    VISCOUS_ASYMMETRY,
    COULOMB,
    COULOMB_ASYMMETRY,
    STRIBECK,
    PRESLIDING,
    QUADRATIC_DRAG,
    LOAD_FRICTION,
    POSITION_FRICTION,
    FRICTION_DRIFT,
    GRAVITY,
    STIFFNESS,
    CUBIC_STIFFNESS,
    INERTIA,
    COUPLING,
    ELASTICITY,
    BACKLASH,
    HYSTERESIS,
    RIPPLE,
    TORQUE_GAIN,
    TORQUE_OFFSET,
    DEAD_ZONE,
    SATURATION,
    LAG,
    DELAY,
    ENCODER_ECCENTRICITY,
    DISTURBANCE,
    FOREIGN,
    PAYLOAD,
    CONCEALED_KINDS
} concealed_kind;

typedef struct concealed_name {
    const char *name;
    /* NULL where there is none; all that are named must be given */
    const char *parameter[CONCEALED_PARAMETERS];
} concealed_name;

static const concealed_name concealed_names[CONCEALED_KINDS] = {
    [VISCOUS] = {"viscous", {"coefficient"}},
    [VISCOUS_ASYMMETRY] = {"viscous_asymmetry", {"coefficient_pos", "coefficient_neg"}},
    [COULOMB] = {"coulomb", {"level"}},
    [COULOMB_ASYMMETRY] = {"coulomb_asymmetry", {"level_pos", "level_neg"}},
    [STRIBECK] = {"stribeck", {"breakaway", "velocity"}},
    [PRESLIDING] = {"presliding", {"stiffness"}},
    [QUADRATIC_DRAG] = {"quadratic_drag", {"coefficient"}},
    [LOAD_FRICTION] = {"load_friction", {"coefficient"}},
    [POSITION_FRICTION] = {"position_friction", {"amplitude", "period", "phase"}},
    [FRICTION_DRIFT] = {"friction_drift", {"ratio", "time_constant"}},
    [GRAVITY] = {"gravity", {"torque", "angle"}},
    [STIFFNESS] = {"stiffness", {"coefficient", "neutral"}},
    [CUBIC_STIFFNESS] = {"cubic_stiffness", {"coefficient", "neutral"}},
    [INERTIA] = {"inertia", {"amount"}},
    /* law 0 inertia, 1 coriolis, 2 viscous, 3 coulomb */
    [COUPLING] = {"coupling", {"from_joint", "law", "coefficient"}},
    [ELASTICITY] = {"elasticity", {"stiffness", "damping", "load_inertia"}},
    [BACKLASH] = {"backlash", {"gap", "stiffness", "load_inertia"}},
    [HYSTERESIS] = {"hysteresis", {"force", "stiffness", "exponent"}},
    [RIPPLE] = {"ripple", {"order", "amplitude", "phase"}},
    [TORQUE_GAIN] = {"torque_gain", {"ratio"}},
    [TORQUE_OFFSET] = {"torque_offset", {"level"}},
    [DEAD_ZONE] = {"dead_zone", {"width"}},
    [SATURATION] = {"saturation", {"level"}},
    [LAG] = {"lag", {"time_constant"}},
    [DELAY] = {"delay", {"time"}},
    [ENCODER_ECCENTRICITY] = {"encoder_eccentricity", {"amplitude", "phase"}},
    [DISTURBANCE] = {"disturbance", {"level", "begin", "duration"}},
    /* laws that the contract has no name for, see concealed.h */
    [FOREIGN] = {"foreign", {"law", "amplitude"}},
    /* on the link that the joint moves, in the frame of that link */
    [PAYLOAD] = {"payload", {"mass", "x", "y", "z"}},
};

typedef struct concealed_effect {
    concealed_kind kind;
    int joint;                      /* from 0 */
    double p[CONCEALED_PARAMETERS]; /* in the order of the table above, SI units */
    double s[3];                    /* states of its own; of a link place, speed, acceleration */
    double from[2];                 /* of a link: place and speed where the step began */
    double motor, now;              /* kg m^2 before a transmission; at this pose */
    long cursor;                    /* of a delay: its place in the history of commands */
} concealed_effect;

/* Next word of `*at` into `word`; 0 at the end of the line. */
static inline int concealed_word(const char **at, char *word) {
    size_t n = 0;
    while (**at == ' ' || **at == '\t')
        (*at)++;
    while (**at && **at != ' ' && **at != '\t') {
        if (n + 1 < CONCEALED_WORD)
            word[n++] = **at;
        (*at)++;
    }
    word[n] = 0;
    return n > 0;
}

/* One line; 0, or -1 with a sentence. */
static inline int concealed_parse(const char *line, int joints, concealed_effect *e, char *error,
                                  size_t error_size) {
    char word[CONCEALED_WORD];
    const char *at = line;
    unsigned given = 0;
    *e = (concealed_effect){.kind = CONCEALED_KINDS};
    concealed_word(&at, word);
    for (int k = 0; k < CONCEALED_KINDS; k++)
        if (strcmp(word, concealed_names[k].name) == 0)
            e->kind = (concealed_kind)k;
    if (e->kind == CONCEALED_KINDS) {
        snprintf(error, error_size, "concealed: no effect '%s'", word);
        return -1;
    }
    const concealed_name *name = &concealed_names[e->kind];
    while (concealed_word(&at, word)) {
        char *value = strchr(word, '='), *end = NULL;
        int known = 0;
        if (value) {
            *value++ = 0;
            const double x = strtod(value, &end);
            if (end == value || *end || x != x) {
                snprintf(error, error_size, "concealed: %s: %s is '%s', expected a number",
                         name->name, word, value);
                return -1;
            }
            if (strcmp(word, "joint") == 0) {
                e->joint = (int)x - 1;
                known = 1;
            }
            for (int i = 0; i < CONCEALED_PARAMETERS && name->parameter[i]; i++)
                if (strcmp(word, name->parameter[i]) == 0) {
                    e->p[i] = x;
                    given |= 1u << i;
                    known = 1;
                }
        }
        if (!known) {
            snprintf(error, error_size, "concealed: %s has no parameter '%s'", name->name, word);
            return -1;
        }
    }
    for (int i = 0; i < CONCEALED_PARAMETERS && name->parameter[i]; i++)
        if (!(given >> i & 1u)) {
            snprintf(error, error_size, "concealed: %s lacks its parameter '%s'", name->name,
                     name->parameter[i]);
            return -1;
        }
    if (e->joint < 0 || e->joint >= joints ||
        (e->kind == COUPLING && (e->p[0] < 1.0 || e->p[0] > joints))) {
        snprintf(error, error_size, "concealed: %s: joint out of range, the machine has %d",
                 name->name, joints);
        return -1;
    }
    return 0;
}

/* All lines effect1, effect2, … of a configuration; their number, or -1 with a sentence. */
static inline int concealed_parse_all(const char *config, int joints, concealed_effect *effects,
                                      char *error, size_t error_size) {
    char key[CONCEALED_WORD], line[256];
    int count = 0;
    for (; count < CONCEALED_EFFECTS; count++) {
        snprintf(key, sizeof key, "effect%d", count + 1);
        if (machine_config_text(config, key, line, sizeof line) != 0)
            break;
        if (concealed_parse(line, joints, &effects[count], error, error_size) != 0)
            return -1;
    }
    return count;
}

#endif
