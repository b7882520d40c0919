/* The tables of a system, filled by tables.py, and what is computed from them.

   Unknowns of the linear system: the bodies' blocks one after another (twist in world axes, then modes), then the rows of the
   constraints. Arrays of velocities and residuals have the same order, with the twists of the surfaces behind the bodies' blocks
   instead of the rows. Frames: bodies, ground, surfaces. */

#include <complex.h>
#undef I
#include <float.h>
#include <math.h>
#include <string.h>

#if DIM == 3
enum { D = 3, ROT = 3, POSE = 7, TWIST = 6, PORT = 12, FRAME = 18 };
#else
enum { D = 2, ROT = 1, POSE = 3, TWIST = 3, PORT = 6, FRAME = 10 };
#endif
enum { TURN = D, SPEED = D + D * D, SPIN = SPEED + D };  /* where R, v, w begin in a frame */
enum { WORST = 5 };                                      /* what of records only the largest is kept of */
enum { ANGLE = FRAME + D, SIGHT = ANGLE + (D == 2) };     /* of a marker in records: its own frame, x'', in the plane its angle */

enum { ROW, LINEAR, GIVEN, LAW, READ, FORMULA, MOUNT, WHOLE, TERM }; /* roles of items: a term of a constraint; an effort that is linear, */
                                                          /* given for the whole step, or from a law in Python; READ: only */
                                                          /* looked at in records; FORMULA: one of formulas.c; MOUNT: bushings; */
                                                          /* WHOLE: wrenches on two markers from Python; */
                                                          /* TERM: of a sum of coordinates, see sums.c */
enum { POINT, SQUARE, DISTANCE, QUOTIENT };               /* of an effort over a step that keeps energy: at its mean point; else by */
                                                          /* differences of s, see mechanics/joints/relative.py */
enum { DONE, NEWTON, SINGULAR, LOOK, FAILED, GAIN, SIZE, DOUBT }; /* verdicts; LOOK: the NumPy path has something to say; */
                                                          /* FAILED: a law in Python raised; GAIN: energy from nothing; SIZE: */
                                                          /* the next step may have another size; DOUBT: whether the state */
                                                          /* counts is to be looked at closely */
enum { ON_ITS_OWN, FIRST, FOLLOWING, AGAIN };              /* evaluations: of a state; of the first iterate of a step, of one that */
                                                          /* follows another, of the same with laws as there; see bridges.c */
enum { RECENT = 8 };                                       /* samples that are kept, and whether they hold; ANEW: from now on */
enum { FORGETS, RECALLS, ANEW };
enum { LINE = 5, MOST_POINTS = 7 };                                      /* s, s', N, dN/ds and dN/ds' where Newton's iteration was last */
enum { CONJUGATE = 32, CLOSING = 6 + 2 * CONJUGATE };       /* directions that a further one is conjugate to; room for close_softened() */
enum { GOES_ON, CONVERGED, DIVERGED, TOO_SLOW };           /* outcomes of Newton's iteration of an implicit step */
enum { ALPHA, RATTLE, RUNGE_KUTTA, HALF_EXPLICIT, MEANS, RADAU, BDF, THETA_RULE }; /* schemes that make many steps in one call, see march.c */

/* Of items; ``W``: weights of a tangent, or where it is not NULL the first of both rates is wanted alone. */
typedef void kernel(long n, const int *pair, const double *frames, const double *P, const double *W, double *out);

/* Items of one kind between frames of like sort: all entries of their rows that are not on the ground are ``live``. Sums of
   coordinates have terms, the batches that stand before theirs, and no kernels. */
typedef struct {
    kernel *value, *rates, *tangent;   /* of the kind, see mechanics/kinds/derivation.py */
    int role, outputs, live, products, curved, number; /* outputs: of the value kernel; number: for calls into Python */
    int flow;                          /* whether the kind is a speed; a ROW then holds velocities and has no s */
    int driven;                        /* whether a motion of time is among its constants; s' has a part of its own then */
    int linked, aside;                 /* LAW of a controller: whether it reads more than its coordinate; LAW: whether it is looked at */
                                       /* beside the state, see bridges.c */
    struct Act *act;                   /* LAW: of a controller, else NULL */
    int quotient;                      /* efforts: POINT .. of what they do over a step */
    int told;                          /* READ: whether its s and s' are told at every evaluation, to controllers */
    int terms, sides;                  /* sums: of how many; frames of an item, 2 but for sums and constraints of own equations */
    int turning;                       /* sums: whether rows of terms turn, so that efforts are stiff across them */
    int *into;                         /* sums: of each entry of the rows of the terms, to which output it adds */
    double *shift;                     /* sums: n, what is added */
    long n, width;                     /* width: constants of an item */
    int *pair;                         /* n x sides frames */
    double *P, *out;                   /* constants; s and the entries of the row */
    int *entry, *at;                   /* live: which output; n x live: place in velocities and residuals */
    int *row;                          /* ROW: number of the constraint */
    double *factor;                    /* ROW: coefficient of s in it; sums: n x terms, of s of each */
    int *dest;                         /* ROW: n x live places in the fronts */
    double *stiffness, *damping, *free; /* efforts: N = stiffness (s - free) + damping s' */
    double *s, *rate, *effort, *weight, *slope; /* n each */
    double *foretold;                  /* LINEAR: n efforts where the last increment of a step leads */
    double *across;                    /* LINEAR: n, share of an increment that a unit pull misleads; negative: not known of this matrix */
    int formula;                       /* FORMULA: which; n x FORMULA_WIDTH constants, n x MEMORY memory of accepted steps */
    double *constants, *kept;
    double *line;                      /* FORMULA, LAW: MOST_POINTS x n x LINE, see bridges.c; NULL for others */
    int *bridges;                      /* n: whether the law counts as its line */
    long sloped;                       /* LAW: the evaluation for which slopes were asked already */
    long known_to;                     /* LAW, WHOLE: the evaluation up to which answers are known, at how many points of a step; */
    int points, sees, answers;         /* numbers that Python sees, s and s' or the sights, and answers, N or wrenches; */
    double *ahead;                     /* MOST_STAGES x (1 + both): t and these, see foretell_points(); NULL for others */
    double *known;                     /* FORMULA, LAW: n x 3, s, s' and N where the slopes were taken; WHOLE, MOUNT: see whole.c, mounts.c */
    int *first, *second, *product_to;  /* products: pairs of live entries; n x products places in the fronts */
    int *curve, *curve_to, hessians;   /* curved: which outputs of the tangent kernel; n x curved places; outputs in all */
    double *hessian;
    int near, *theta;                  /* column of P with the counted angle; n: its place in q, NULL for other kinds */
    int mapped;                        /* whether frames on surfaces are among them, which have places of their own: */
    int *component;                    /* outputs - 1: twist component of both frames of each entry */
    int *slot;                         /* n: numbers among the readings, -1 for none; NULL where none of them is read */
    int *where;                        /* n x 2 x TWIST: entry of the value kernel (0: none) of each twist component */
    int *lower;                        /* curved x 2: twist components of each output of the tangent kernel */
    long *row_start, *square_start;    /* where an item's places begin in: */
    int *row_to, *row_on, *square_to;  /* places of its row and the unknowns it acts on, places of the lower half of its block */
    int *marker, *astray;              /* WHOLE: n x 2 rows of the sights; whether the slopes misled since they were taken */
    double *sight, *push, *K, *B;      /* markers: x, R, twist; n x 2 wrenches; slopes of each force, see whole.c */
} Batch;

/* What a controller reads: a joint coordinate or its rate, or of a marker the place, the velocity, the angular velocity, the rotation. */
enum { COORDINATE, ITS_RATE, PLACE_OF, VELOCITY_OF, ANGULAR, TURNED_BY };
typedef struct {
    int what, batch, frame, first, count; /* batch: that tells the coordinate; frame: of the marker; its numbers among all readings */
    double arm[D], turn[D * D];        /* the marker in its frame */
} Reading;

/* An effort of a controller. */
enum { OTHERS, OWN_PLACE, OWN_RATE };
typedef struct Act {
    int number, first, count;          /* among all efforts; the numbers that its controller reads */
    int *own;                          /* count: OTHERS ..: whether they are those of the coordinate that it acts on */
    double *slopes;                    /* count: du/dy */
} Act;

/* Memories at the points of an implicit step, see implicit/memories.c: at most so many points, and ends of steps before the last one. */
enum { MOST_STAGES = 7, PAST = 5, ENDINGS = PAST + 1 };

/* What a PID controller keeps: its integral, the rate and the time of an accepted step, the largest so far, what rates count as at least,
   where steps before have ended, and the rate at the newest of these. */
typedef struct {
    double z, rate, t, size, reach, count, before;
    double times[PAST], values[PAST];
    double points, when[MOST_STAGES], then[MOST_STAGES]; /* of the step under way: how many, and the integral there */
    double error[MOST_STAGES], speed[MOST_STAGES], slope; /* what is read there against the target; of the rate at the last, by z */
} PidMemory;
enum { MEMORY = 7 + 2 * PAST + 4 * MOST_STAGES + 2 }; /* numbers of it, and of what dry friction keeps */

/* How memories hang together at the points, sum couple z + sum past z_(n-l) = z', and the error of a step: a sum of these and of the rate
   where it began, over ``frequency`` less the slopes of rates, unless that is 0. */
typedef struct {
    int points, ends;
    double t[MOST_STAGES], couple[MOST_STAGES * MOST_STAGES], past[MOST_STAGES * ENDINGS], end[ENDINGS]; /* end: times */
    double of_points[MOST_STAGES], of_ends[ENDINGS], of_rate, frequency, rtol, atol, error;
    double lead;                       /* by how much memories answer to rates where a tangent is taken, s */
    int integrals, asked;              /* whether there are PID controllers, and laws in Python; all that these read at the points: */
    double *y;
} Remembered;

/* All controllers whose law is asked at every evaluation, see control.c. */
typedef struct {
    int readings, fresh;               /* fresh: whether y and u are those of the frames as they are placed */
    long sloped;                       /* the evaluation whose slopes these are */
    Reading *reading;
    double *y, *u, *known_y, *known_u; /* known: where the slopes of the matrix were taken */
    int ahead;                         /* the batch that has what all are asked ahead; negative: memories have to be known before */
} Controllers;

/* What moves with a body, as its coordinates say: a surface by its mean; the section of a line, whose ports are x, y and an angle; the
   places of a surface times a multiplier, integrated. */
enum { MEAN, SECTION, INTEGRAL };

/* A surface of a reduced or elastic body, symbols as in mechanics/frames.py. */
typedef struct {
    int body, sort;                    /* MEAN .. */
    double measure;                    /* INTEGRAL: of its multiplier, m; 1 for others */
    double *reference, *ports, *now;   /* PORT, PORT x modes: of the surface; now: rates of ports of second order, a row */
    int bends;
    double *N, *G;                     /* PORT x bends, bends x modes x modes, each by columns */
    double p[D];                       /* lever of the marker from the centroid */
    double b[PORT];                    /* its ports */
    double Z[ROT * ROT], turn[D * D], lever[D], arm[D];
    double *map;                       /* TWIST x (TWIST + modes): twist of the surface from the body's rates, world axes */
    double *bend_map;                  /* TWIST x bends */
    double bias[TWIST];                /* rate of the twist at no accelerations of the body, see surface_bias() */
} Surface;

/* Integrals of a compiled form over cells or facets: forces on the nodes from values at them; see forms.c. */
enum { PLACES_OF, RATES_OF, PRESSURES_OF, ENDS_OF, FROM }; /* what moves: U, U' and p, or U at the end of a step */
typedef struct {
    void (*kernel)(void);              /* FFCx's */
    long count;                        /* of cells or facets */
    int nodes, components, corners, width; /* of a cell: nodes with so many numbers, points of its shape, coefficients */
    int *node, *corner, *facet;        /* count x nodes, count x corners; of its cell, NULL over cells */
    double *points, *constants;        /* 3 each */
    double *coefficients;              /* count x width, of which these move: */
    int moving[FROM];
    int *place[FROM], *from_[FROM];    /* moving; count x moving */
    double *factor, *room;             /* of the whole; work: width + nodes x components + 3 x corners */
} Integral;

/* The pressure of a field, C p = b with b = B U, or of integrals at p = 0: unknowns behind the displacements of its factor,
   E = [E, B^T; B, -C]; or an unknown beside U, with a balance of its own; see pressure.c. */
typedef struct {
    long n;
    int *B_start, *B_column, *C_start, *C_column; /* by rows of the pressure */
    double *B, *C;
    double *b, *x, *p;                 /* n each: C x = b; p, which is x where it follows U */
    void **factor, *rhs, *solution;    /* of C; vectors on b and x */
    int integrals, keeps_volume;       /* of the balance, where this is not linear; whether that is to have no part in p */
    Integral *integral;
    double *gap, *began;               /* n each, NULL where p follows U: its balance; p where a step began */
} Pressure;

/* A matrix by rows of nodes, D x D blocks. */
typedef struct {
    int *start, *column;
    double *block;
} NodeMatrix;

/* Springs between numbers of a field, N = k (e + offset), e = B U, one-sided ones N >= 0; K of the field has all of them. */
typedef struct {
    int count, switched;               /* switched: whether other ones are slack at the forces told last than in the tangent */
    int *start, *on, *one_sided, *slack; /* B by rows; count each: slack in the tangent */
    double *row, *stiffness, *offset;
} Droppers;

enum { DAMPINGS = 2 };

/* The elastic field U of a floating body, which its own factor eliminates from the step's matrix; see fields.c. */
typedef struct {
    long n, nodes;
    int solved, frames, row, sways, number; /* columns of H in the factor; frame conditions and their first row; whether the */
                                       /* moments of M U act on the frame's inertia; for the call into Python */
    int column;                        /* the first of these columns, among those of all fields in the order of their numbers */
    int inertial, turns;               /* columns of inertia: TWIST, none where the frame rests; whether the factor turns with U */
    double *X;                         /* nodes x D, at rest */
    double *Q, *port;                  /* H: inertial x n columns of inertia, then the entries of columns of ports */
    int *port_start, *port_on;         /* by columns */
    double *drift, *curve, *moved, placed_at; /* of ports that move along the body: rates of their entries, NULL without; rates of */
                                       /* these; modes: what these rates have of those of the numbers H^T U; when, s */
    int *M_start, *M_column, *K_start, *K_column; /* by rows of nodes: scalars, D x D blocks */
    double *M, *K;                     /* K without stress */
    NodeMatrix *masses;                /* M of nodes whose numbers are no places, in place of the scalars; NULL without; with */
    double *weight;                    /* D x n: what gravity along each axis acts with on these */
    Droppers *droppers;                /* NULL without */
    double alpha, beta;                /* 1/s, s: damping by the mass and by the stiffness */
    NodeMatrix *drag;                  /* of a viscous form, NULL without */
    int integrals;                     /* of internal forces that are not linear, and of loads on the deformed body */
    Integral *integral;
    int means;                         /* of the same over a step that keeps energy; 0: Python tells them */
    Integral *mean;
    double *dead, *following, *internal; /* n each: loads at a time (s), NULL without; in world axes, in those of the frame, without */
    double *carried;                   /* a resultant; those of the second that displacements do not shift */
    double loaded_at;
    int own, whole;                    /* whether Python tells forces and energies, those of inertia and weight too, from: */
    double *state, *sums;              /* R, twist, its rate, pose, gravity, U, U', U''; TWIST: rows of the frame, or energies */
    double *inertia, *moment;          /* of the columns of inertia: ROT x ROT; D: sum of M P */
    double *Y, *S;                     /* solved x n, solved x solved: see fields.c */
    double *A, *W, *G;                 /* frames x frames: A^-1; solved x frames: H^T E^-1 C; frames x solved: A^-1 C^T E^-1 H */
    int *frame_slot;                   /* columns of the frame conditions */
    double *p, *rates;                 /* H^T U and H^T U' */
    double *accel, *force, *MU;        /* n each: work, force on the nodes, M U of the factor's configuration */
    double *b, *z;                     /* wide each: E z = b, by Python; b: Newton's increment, for new tangents */
    double *MX, *began, *T;            /* n; rotation of the factor's tangent, sum of X (M X)^T; rotation since, see turn_factor() */
    double *pz, *rest, *f, *h;         /* solved each, frames: see fields.c */
    int stresses, bends, stressing;    /* with stiffening: of inertia, where C tells the forces; ports of second order; loads */
    int *stress_start, *stress_column; /* by rows of nodes: scalars of each entry, see stiffened.c */
    double *stress, *N;                /* N: modes x bends */
    double *bent, *form;               /* n x scalars; 3 x scalars */
    double *load_factor;               /* of loads whose stress stiffens, at a time; how each goes with the body, see stiffened.c; with */
    int *load_turns;
    NodeMatrix **turning;              /* what displacements add to nodal forces, NULL of those that are not carried along */
    double *bias, *pull;               /* modes, NULL where second derivatives are those of U alone; work: bends */
    double *held, *second;             /* of the tangent: bends x n, G_r U; TWIST x TWIST of the frame, NULL without stiffening */
    double *one, *first;               /* nodes: M 1; D + D x D: int rho X, int rho X X^T */
    int (*direct)(void *factor, void *rhs, void *solution); /* PETSc's MatSolve: with */
    void **factor, *rhs, *solution;    /* its matrix, NULL where Python solves and when it is freed; vectors on b and z */
    int by_component;                  /* whether it is that of the masses of one component; with room, nodes each, and vectors on it: */
    double *one_b, *one_z;
    void *one_rhs, *one_solution;
    double *told;                      /* solves, and the worst of their relative residuals */
    double of_mass[2], of_stiffness[2], of_damping[2*DAMPINGS]; /* E = of_mass M + of_stiffness K + .. C, real and imaginary parts */
    double tolerance;                  /* a relative residual that is small */
    NodeMatrix *damping[DAMPINGS];     /* C of a viscous form, and of the stiffness without stress; NULL without */
    int parts;                         /* 2 where factor and columns are complex: all but the real parts stands behind these */
    long wide;                         /* unknowns of the factor: n, and those of the pressure */
    double *tangent, *elastic, *left, *more; /* K of the factor; wide: of_stiffness z, one part; E z - b, and the change of */
    void *residual, *change;           /* z that it asks for, NULL but with an unknown pressure, and vectors on both */
    double *asked, asked_at;           /* U, U', R, p and the time (s) of the last forces that were found without those of inertia: */
    double *held_force, *held_sums;    /* n; TWIST, rows of the frame in body axes */
    Pressure *pressure;                /* NULL without */
} Field;

/* L and 1 / D of a complex symmetric matrix L D L^T, its unknowns in an order; L by columns, without its diagonal of ones. */
typedef struct {
    long n;
    const int *start, *row, *order;
    const double *L, *inverse;
    double *work;                      /* 2 n */
} Symmetric;

/* A part that Python tells, see told.c. */
typedef struct {
    int number, rests;                 /* for the calls into Python; whether its frame rests: that of a part on the ground */
    double *slopes, *known;            /* modes x modes by coordinates, and by rates; modes: both, and rows, where these were taken */
    double *state;                     /* R, twist, its rate, pose, gravity, u, u', u'' */
    double *rows, *block;              /* TWIST + modes: forces, or energies; the step's block, world axes */
    double *masses;                    /* the block of a step without stiffness and damping, NULL where masses move with the part */
    double *ahead;                     /* MOST_STAGES x: time, u, u', u'' of points that are asked for together, and rows; NULL: never */
    int foretold;                      /* how many of them are known */
    int *dest;                         /* places of the lower half of the block */
} Told;

typedef struct {
    int modes, at_v, at_q, at_u;       /* places of the modes in v and q, of the block among the unknowns */
    double mass, large;                /* bound of eta . modal mass . eta */
    double *inertia;                   /* rigid: ROT x ROT, body axes */
    double *S, *T, *V, *modal, *K, *C, *stress; /* reduced, see mechanics/reduction/reduced.py; stress NULL without stiffening */
    double *U, *now, *bent;            /* work: T(e_a, p), stiffness of the present stress, K_c eta and K_ij eta, a row */
    double *mean, *heavy, *block;      /* J^-1 of second_order.py, TWIST x TWIST; work: 4 TWIST x (TWIST + modes), the step's block */
    double *mean_rates;                /* twist of the mass in its frame by rates of the modes, or of U, body axes; NULL without */
    int *dest;                         /* places of the lower half of the block */
    Field *field;                      /* of floating elastic bodies, whose modes are the numbers H^T U; else NULL */
    Told *told;                        /* of a part that Python tells, beside a rigid body or alone; else NULL */
} Body;

/* An angle counted over revolutions, mechanics/joints/counted.py: axes in the two frames, e the joint's, f, g across. */
typedef struct {
    int a, b;
    double ea[D], fa[D], ga[D], eb[D], fb[D], gb[D];
    double zero;                       /* in the plane: at the start */
    int free;                          /* whether a or b are surfaces that turn as a whole, without a frame */
} Angle;

/* The finite elements of one rod in space: n elements of k nodes (frames, ascending along the rod) and ``points`` Gauss points. */
typedef struct {
    int k, points, nodes, number;      /* nodes: of the rod, for loads; number: of a section law in Python, -1: linear */
    long n;
    int *node, *loaded;                /* n x k frames; nodes: frames */
    double beta;                       /* time of Kelvin-Voigt damping */
    double *N, *slope, *weight;        /* points x k; n x points x k, by arc length; n x points, lengths */
    double *natural, *C;               /* strains free of stress; stiffness of the section, 6 x 6 a point */
    double *z, *E, *strain, *rate, *S, *density; /* at the points: see rods.c; density of the energy, of laws in Python */
    double *load;                      /* nodes x LOADED */
    int arms;                          /* of viscoelastic sections: stiffness, arms x points x 36; times, s; memory, see relaxation.c; */
    double *arm, *tau, *kept, *follows; /* work: shares of their springs in the matrix */
    int *to;                           /* places of the lower half of an element's block, node by node */
} Rod;

/* A dense part of the factor: its first ``pivots`` columns are eliminated, the rest goes to the next front. */
typedef struct {
    int pivots, rows, ld, next;
    int apart;                         /* whether it is an attitude with the rows that hold it, see tables/tables.py */
    int firm;                          /* whether some of its rows stand beside bodies with a weight, see factor.c */
    long start;                        /* of its columns in the storage */
    int *unknown;                      /* rows */
    int *to;                           /* rows - pivots: their rows in the next front */
} Front;

/* What a joint does to its first body, or a force element to one of its bodies, in records: its items on the side of that body. */
typedef struct {
    int items, frame;
    int *batch, *item, *side;
    double p[D];                       /* its point in the frame */
} Reaction;

/* Springs whose efforts are unknowns of an implicit step beside the multipliers: which items of each batch, and their numbers among
   these efforts. */
typedef struct {
    int count, *start, *item, *number; /* start: batches + 1 */
    const double *efforts;             /* of the point that is evaluated */
} Ties;

typedef struct {
    int bodies, surfaces, batches, fronts, angles, rods, rows, nu, nv, nq, redundant;
    int fields, core;                  /* bodies with a field; the rates of all others and of frames come first in v */
    Body *body;
    Surface *surface;
    Batch *batch;
    Front *front;
    Angle *angle;
    Rod *rod;
    double *frames, *velocity, *residual;
    double *gap, *motion, *gravity, *weight, *diagonal;
    double *locked;                    /* rows: 1 for those that the last factor has found no pivot for */
    double *firm;                      /* 2 x rows: weights of rows beside the bodies that they hold; these times what is asked of them */
    int *row_dest;                     /* diagonal places of the rows */
    long storage;
    double *L, *inverse, *b, *local;
    signed char *sign;                 /* of the pivots, by unknowns */
    double *units, *row_units;         /* nv, rows: what turns increments and gaps into lengths */
    double *multiplier_units;          /* rows: what multipliers are divided by to be compared as forces */
    int (*python)(int what, int number, double t); /* what: see below; 0 when all is well */
    int samples, stiff;                /* whether Python is asked once a step, 2: for less without the rates of motions; whether */
                                       /* efforts depend on the motion */
    double cd, ck, epsilon;            /* of the matrix in the fronts */
    int dear, held;                    /* whether its factor is dear, see is_dear(); whether one of an earlier step of a march serves on: */
    int first_took, untold;            /* increments of that step; steps since its rate of convergence was told, with the next one */
    int pause, without;                /* steps that go without one behind those that failed, and how many still do */
    double share;                      /* change of q over that of v in a step: open speeds times it are closed like gaps */
    const double *q;                   /* the configuration evaluated last */
    double *work, *big, *directions;   /* directions: (CLOSING + 2) x parts x rows, see with_all_rows(), driver_least() */
    long evaluations, factors, calls;
    int remembers;                     /* whether some formula or rod has a memory; 2: a controller in Python has one */
    int seen, readings, reactions;     /* of records: frames, items that are read, joints whose reaction is */
    int *seen_frame, *seen_angle, accelerated; /* whether angles (plane), and accelerations, of what is seen are recorded */
    double *seen_place;                /* seen x (D + D x D): places of the markers in their frames, and how they are turned */
    Reaction *reaction;
    double *motion_rate, *motion_second, *rest_gravity, *slip;
    double settled;                    /* Newton's tolerance of a step */
    int again;                         /* where in ``work`` a second solution has its own, see sway() */
    int renewed;                       /* whether forces as a whole get new slopes at any rate */
    int led;                           /* whether the matrix takes the efforts foretold: after an increment of a step */
    int renewable, foretells, begins, renewals; /* whether Python takes new tangents of fields in a step, where the last increment */
                                       /* led, and where it is predicted; how many the last step took */
    int keeps_tangents;                /* whether these are kept until increments have paid for new ones */
    Controllers *controllers;          /* NULL without any */
    Remembered *remembered;            /* NULL where no memory is found at points */
    int straight;                      /* whether laws count as their tangents at the last evaluation before */
    int linkable, links;               /* how many efforts may answer to more than their coordinate, and do; see links.c */
    double *push, *pull;               /* linkable x (nu + TWIST surfaces + 1); parts linkable x parts (nu + TWIST surfaces + 1) */
    double *answer, *mutual;           /* parts linkable x parts (nu + rows); x parts linkable */
    int indefinite;                    /* whether the tangent of a field may be so: of bodies that buckle */
    int point, bent;                   /* which of a step is evaluated; whether the slopes of all laws are asked for at all points */
    long begun;                        /* the evaluation of its first iterate */
    int swung;                         /* whether a law changed since the last iterate by much that the tangent does not tell */
    const double *noted;               /* slopes of formulas in the tangent of an implicit step, see note_slopes(); NULL else */
    int iterate, bridged;              /* what is evaluated: ON_ITS_OWN ..; whether laws count as lines at the newest iterate */
    int leaves_out;                    /* whether the matrix lacks terms of the motion of a body, see secants.c */
    const double *from;                /* where a step begins whose mean forces fields tell in place of those of a state; NULL else */
    double span;                       /* its size, s */
    int timed;                         /* arrays that a SAMPLE writes, and how long they are: */
    double **timed_at;
    long *timed_size;
    double *sampled[2];                /* as long as all of them: samples at the two times of a stage, see explicit.c */
    int recalls, newest;               /* RECALLS: samples of late hold, of this call of C or since Python has taken a state; */
    double *recent, recent_at[RECENT]; /* their numbers and times: one that is wanted again is not asked for again */
    int parts, imaginary;              /* 2 where the matrix is complex, see Field; whether its imaginary part is assembled */
    int answered;                      /* whether fields know z of the forces on their nodes that come next */
    double *lossy;                     /* that part of the fronts */
    const Ties *ties;                  /* whose efforts are given; NULL: all are those of the state */
    struct ElasticContact *contact;         /* what bodies may touch in the steps of a march, NULL without, see elastic_books.c */
} System;

/* A number of a record that an event is about, times ``scale``: where it is in the first one, how many numbers further in the next;
   from which side it is to cross its level (1 from below, -1 from above, 0 any); what it was beyond that level before the newest
   step. */
typedef struct {
    const double *at;
    long stride, direction;
    double scale, level, before;
} Crossing;

/* A series that grows with every record by ``width`` numbers of it, times ``scale``, behind each other from ``to`` on: where the
   first is in the first record, how many numbers further the next, and how many the same one of the next record. */
typedef struct {
    const double *at;
    long stride, apart, width;
    double scale;
    double *to;
} Series;

/* Steps in which somebody waits for an instant, or ``each``: copies of the states at their ends, for polynomials through these.
   Python takes them when the march has ended; it does where there is no room for one more. */
typedef struct {
    const double *instant;             /* rising, s */
    long instants, passed;             /* how many, and how many of them are not behind the newest step */
    double roundoff;                   /* s */
    long steps, capacity, count, own;  /* of the march; kept ones at most, and so far; numbers that a scheme keeps with a state */
    long most, each;                   /* of them that one step may take; whether all are kept */
    long *number;                      /* of each, which step of the march it is */
    double *newest, *begin, *earlier;  /* at its end, with what the scheme keeps, at its beginning, and at that of the step before, nan */
                                       /* where forces jump between */
    double *last;                      /* at the beginning of the newest step, or of the one before where an event is met in that */
} Kept;

/* Records of accepted steps; every array holds as many as a march makes and one more, which steps that are only looked at are written
   to, or where all is in ``series`` (``single``) the newest alone. ``left``: steps up to the next; ``crossed``: whether a march ends
   because of an event; ``meets``: steps up to one in which it is known that one is met, 0 where none is. */
typedef struct {
    long every, left, count, crossings, crossed, meets, straight, single;
    Crossing *crossing;
    Series *series;                    /* straight of them */
    long whole, rows, doubtful;        /* whether states and multipliers are kept; first record whose joints are open, or -1 */
    double allowed, roundoff, length;  /* m; share of the distance from the origin; of the model */
    double *units;                     /* of the rows, as lengths */
    double *block, *lam, *sight, *energy, *reading, *reaction; /* sight: SIGHT each */
    double *doubt;                     /* the state of the doubtful record */
    double worst[WORST], before[WORST]; /* largest of all records, and of all before the newest: open by, opening at, this as a */
                                       /* speed, speed, rate of turning */
    double *contact;                   /* where there are contacts: see moreau.c */
    Kept *kept;                        /* NULL: nobody waits for instants */
    double judged;                     /* when the state was whose joints were judged last, s */
} Tape;

/* By what the joints of every state of a march are judged, see run/judges/acceptance.py: units of the rows as lengths; the gap (m) that
   is allowed, and its share of the distance from the origin; the speed (m/s) at which they may open, infinite where rates do not
   count, and its share of the ``fastest`` speed so far. The march ends with a state whose ``speed`` is above ``most``. */
typedef struct {
    const double *units;
    double allowed, roundoff, length, opening, share, fastest, speed, most;
} Closed;

/* Deformations of one body in the norm of errors (control.c). */
typedef struct {
    int at_q, at_v, n;
    const double *rms;                 /* displacements at amplitudes of one; NULL: the coordinates are those of a field's nodes */
    double size, reached;              /* m, the largest displacement so far, and with the newest state */
} Deflection;

/* Error control of a march of generalized-alpha: ways so far, and what the next step may be. See control.c. */
typedef struct {
    struct OwnSteps *own;              /* tolerances, sizes so far, what proposes sizes: see own_steps.c */
    double least, way, reached, foretold; /* shares of the length; foretold: by a step that was refused */
    double unknown;                    /* what increments of places may be roundoff of, m */
    const double *origin;              /* the configuration that ways are measured from */
    long frames, core;                 /* that move, and entries like v of these and of what is no field */
    long laws;                         /* whether forces follow laws, whose stiffness may not last */
    long drags;                        /* whether damping may be that of forces alone, which gives no place back */
    long coordinates;                  /* of bodies that are no deformations, each of a size of its own */
    int *coordinate;                   /* where these stand in v */
    long chooses, timed, bends;        /* whether C may change sizes; whether loads want looks; whether bodies bend */
    long place, count, more;           /* of the stretch: in steps of this size, and of how many; how many as long may follow */
    double stretch, end, last;         /* its length and its end; until when steps may begin, s */
    double lost, until;                /* size of steps in which masses are lost beside stiffness, and until when, s */
    double calm;                       /* error below which nothing happens */
    double quiet, quiet_size, looked;  /* up to when loads have been looked at, in steps of which size; the largest such size, s */
    double proposed, size;             /* for the next step, and of the newest, s */
    double size_before, missed;        /* of the step that the controller remembers, 0: there is none, and its error */
    double trial, tried;               /* error of the newest try at a step; size of the newest that has failed, s */
    double error, largest;             /* of the newest step, and of all of a march */
    long refused, refusals;            /* errors that have refused the next step so far, and all of a march */
    double *fastest, *faster;          /* speed and spin of frames so far, m/s and rad/s, and with the newest state, 2 each */
    double peak, fading;               /* the largest of late, which fades by this factor from step to step */
    double *e, *y, *a, *missed_speed;  /* work: like v, the rows, like v twice */
    double *reaching, *racing;         /* work: sizes and speeds of coordinates with the newest state, like v */
    double *open, *noise, *v, *A;      /* work: the rows twice; what the newest state had before a change of size, like v */
} Control;

/* What Python is asked for, and its answer where a body does not go: NumPy makes, or refuses, the step. */
enum { SAMPLE, EFFORT, SLOPES, WRENCHES, SECTIONS, SECTION_SLOPES, WHOLE_SLOPES, FIELD, FIELD_FORCES, FIELD_ENERGIES,
       FIELD_TANGENTS, PART_FORCES, PART_ENERGIES, PART_TANGENTS, KEEP, EFFORTS, EFFORT_SLOPES,
       FIELD_MEANS, EFFORT_MEANS, FREQUENCIES, FIELD_LOADS, PART_SLOPES, PART_POINTS, FIELD_PORTS,
       COLLOCATE, MEMORY_ERROR, TRAPEZOID_ERROR, LEAD_MEMORIES, LOOK_AT_END, EFFORTS_AHEAD, WRENCHES_AHEAD };
enum { OUTSIDE = 2 };

/* Parts of a SAMPLE: all of it, all but the rates of motions, these alone. */
enum { WHOLE_SAMPLE, PLACES, RATES };

