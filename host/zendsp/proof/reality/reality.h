/* The machine as it really is: everything that the given model may lack, in one plain struct.
   No preprocessor lines in this part of the file's text, because cffi reads it as it stands. */

typedef struct {
    /* set-valued friction; level > 0 means a torque against the motion [N m] */
    double coulomb_pos, coulomb_neg;
    double stribeck_extra;          /* Fs - Fc [N m] */
    double stribeck_velocity;       /* [rad/s] */
    double stribeck_exponent;       /* [-] */
    double bristle_stiffness;       /* 0: rigid contact, set-valued law [N m/rad] */
    double bristle_damping;         /* [N m s/rad] */
    double load_mu;                 /* level += mu |actuator torque| [-] */
    double level_amplitude;         /* level += A sin(2 pi q / period + phase) [N m] */
    double level_period, level_phase;
    double drift_ratio, drift_time; /* all friction * (1 + ratio (1 - exp(-t/time))) */
    /* smooth friction */
    double viscous_pos, viscous_neg; /* [N m s/rad] */
    double drag;                    /* [N m s^2/rad^2] */
    /* torques of position, on the load side */
    double gravity, gravity_angle;  /* G sin(q - angle) [N m], [rad] */
    double stiffness, neutral;      /* [N m/rad], [rad] */
    double cubic, cubic_neutral;    /* [N m/rad^3], [rad] */
    double ripple_order[2], ripple_amplitude[2], ripple_phase[2];
    double bw_force, bw_stiffness, bw_exponent; /* Bouc-Wen, beta = gamma = A/2 */
    /* actuator, in the order in which the command passes it */
    double limit;                   /* stated limit, command units */
    double delay;                   /* all of it, the known part too [s] */
    double dead_zone;               /* command units */
    double saturation;              /* concealed limit, command units; 0: none */
    double gain;                    /* [N m per unit of command] */
    double lag;                     /* [s] */
    double torque_offset;           /* opposes like every effect: M qdd + offset = torque [N m] */
    /* transmission */
    double trans_stiffness;         /* 0: rigid [N m/rad] */
    double trans_damping;           /* [N m s/rad] */
    double trans_gap;               /* full width [rad] */
    double motor_inertia;           /* the part of the inertia before the spring [kg m^2] */
    double sensor_on_load;          /* 0 motor, 1 load */
    /* sensor */
    double resolution;              /* 0: none [rad] */
    double floor_counts;            /* 1: floor, 0: round */
    double eccentricity, eccentricity_phase;
    /* something that the table of effects cannot say */
    /* torque on the load over position and speed, row by row; NULL: none [N m] */
    const double *foreign;
    int foreign_rows, foreign_columns;
    double foreign_q, foreign_dq;   /* position of the first row, and from row to row [rad] */
    /* speed of the first column, and from column to column [rad/s] */
    double foreign_v, foreign_dv;
    double extra_inertia;           /* [kg m^2] */
} Joint;

typedef struct {
    int to, from;                   /* 0-based */
    int law;                        /* 0 inertia, 1 coriolis, 2 viscous, 3 coulomb */
    double coefficient;
} Coupling;

typedef struct {
    double rotation[9], place[3];   /* joint frame in the parent's frame at q = 0; the axis is z */
    double mass, com[3], inertia[9]; /* about the centre of mass, in the link's frame */
} Link;

typedef struct {
    int kind;                       /* 0 one joint, 1 planar 2R, 2 serial chain */
    int n;                          /* joints, 1..7 */
    double p[3];                    /* kind 0: inertia, gravity; kind 1: p1, p2, p3 */
    Joint joint[7];
    int couplings;
    Coupling coupling[4];
    Link link[7];
    double down[3];                 /* acceleration of gravity in the base frame */
    double sample_time;             /* [s] */
    int substeps;                   /* per sample */
    double kp[7], kd[7], ki[7];     /* command units */
    double velocity_filter;         /* time constant of the controller's derivative [s], 0: none */
    double q0[7], v0[7];
} Machine;

/* reference, feedforward, torque, noise: rows x n, row-major; torque is what no state explains,
   linear between rows. measured, command, q, v: rows x n; q and v are the true ones on the sensor's
   side; work: rows, mechanical energy. Returns 0, or 1 + the row at which the machine ran away. */
int simulate(const Machine *m, int rows, const double *reference, const double *feedforward,
             const double *torque, const double *noise, double *measured, double *command,
             double *q, double *v, double *energy);

/* tau = M(q) a + bias(q, v) of the mechanism alone; rows x n each */
void inverse(const Machine *m, int rows, const double *q, const double *v, const double *a,
             double *tau);
