/* What the units of the driver know of each other. A unit that no part of a scene needs is not linked, and not called. */

#if defined(__GNUC__)
#define EXPORT __attribute__((visibility("default")))
#define PART __attribute__((weak))
#else
#define EXPORT
#define PART
#endif

/* reduced.c, surfaces.c */
PART int place_surface(System *s, int number, const double *q);
PART void surface_bias(System *s, int number);
PART int reduced_force(const Body *o, const double *R, const double *q, const double *v, const double *a, const double *w,
                       const double *gravity, const double *accel, double *f, double *rows);
PART void reduced_block(System *s, const Body *o, const double *R, const double *eta, double cd, double ck);
PART void reduced_energies(const Body *o, const double *R, const double *q, const double *v, const double *pose, const double *twist,
                           const double *gravity, double *out);

/* fields.c */
PART void add_columns(const Body *o, const double *f, double *x);
PART void field_rates(const Body *o, const double *v);
PART void field_columns(const Body *o, const double *q, const double *v);
PART int move_ports(System *s, double t);
PART int field_force(System *s, int b, const double *q, const double *v, const double *a, double *f, double t);
PART void frame_conditions(System *s, const Body *o, const double *lam);
PART int field_block(System *s, const Body *o, const double *R, const double *q);
PART void condense(System *s, const Body *o);
PART void field_answers(System *s, const Body *o);
PART void answer_node(const Field *e, double c, const double *column);
PART int field_load(System *s, const Body *o, double scale, double t);
PART void field_increment(System *s, const Body *o, double *x);
PART void field_without_load(const Body *o);
PART void close_volume(const Body *o, double *force);
PART void move_pressure(const Body *o, const double *x);
PART void keep_pressure(const Body *o, int back);
PART void field_sway(System *s, const Body *o, const double *R, const double *x);
PART void field_energies(System *s, int b, double t, const double *q, const double *v, const double *gravity, double *out);

/* told.c */
PART int told_force(System *s, int b, const double *q, const double *v, const double *a, double *f, double t);
PART int told_block(System *s, const Body *o, double t);
PART int foretell_part(System *s, const Body *o, int count, const double *t, int each, const double *q, const double *xi, const double *v,
                       const double *a);
PART int take_part_slopes(System *s, const Body *o, const double *q, const double *v, double t);
PART void told_energies(System *s, int b, double t, const double *q, const double *v, const double *gravity, double *out);

/* rods.c, in space */
PART int rod_forces(System *s, Rod *k, double t);
PART int rod_tangents(System *s, Rod *k, double t, double geometric);
PART double rod_energy(System *s, Rod *k, double t);
PART void rod_keep(System *s, Rod *k, double t);
PART void rod_share(const Rod *k, Rod *with);
PART void rod_loads(System *s, const Rod *k);
PART int rod_mean_forces(System *s, Rod *k, const double *q0, const double *q1, double h, double t);

/* mounts.c */
PART void mount_forces(System *s, const Batch *k);
PART void mount_tangents(System *s, const Batch *k, double cd, double ck, double geometric);
PART double mount_energy(const System *s, const Batch *k);

/* whole.c */
PART int whole_forces(System *s, Batch *k, double t);
PART void whole_sights(const System *s, const Batch *k);
PART int whole_tangents(System *s, Batch *k, double t);
PART int take_whole_slopes(System *s, Batch *k, double t);
PART void whole_links(System *s, const Batch *k, const double *cd, const double *ck);

/* Fronts that lead into each other, ascending, and the bodies whose unknowns they hold. */
typedef struct {
    int fronts, bodies;
    int *front, *body;
} Tree;

/* the core */
int side_map(const System *s, int frame, const double **map);
void through(const double *map, int width, const double *y, double *row);
void twist_row(const Batch *k, long i, double *y);
void add_terms(const Batch *k, const double *shares);
void values(const System *s, const Batch *k);
void mapped_square(System *s, const Batch *k, long i, const double *C);
double times_there(const int *on, int r, int c);
int place(System *s, const double *q, const double *v);
void turn_velocity(System *s, const double *v);
int inertia(System *s, const double *q, const double *v, const double *a, double t);
int evaluate(System *s, const double *q, const double *v, const double *a, const double *lam, double t);
int evaluate_iterate(System *s, int done, const double *q, const double *v, const double *a, const double *lam, double t);
enum { NO_PUSH, HARD_PUSH, EVERY_PUSH }; /* reactions that have a geometric stiffness in the matrix of a step */
int prepare(System *s, const double *q, double cd, double ck, const double *lam, int reactions, double t);
void solution(System *s, double *x, double *y);
void tree_solution(System *s, const Tree *t, double *x);
int solve_dense(double *A, int n, double *B, long ld, int columns, double share);
void slips(System *s, int rates);
void configuration(const System *s, const double *q0, const double *xi, double *q);
void energies(System *s, double t, const double *q, const double *v, const double *gravity, double *out);
int keep(System *s, double t);
void share_memory(const System *s, System *with);
void note_readings(System *s, int j);
int find_memories(System *s);
int memory_error(System *s, double *error);
int trapezoid_error(System *s, double t, const double *q, const double *v, double rtol, double atol, double *error);
int friction_overran(System *s, double t, double h, double share);
void hold_friction(System *s, int back);
void drag_friction(System *s, double t);
double largest(const double *x, int n);
double worse(double a, double b);
double largest_of(const double *units, const double *x, int n);
double small(const System *s, const double *p, const double *q, double accelerated);
double correction(int k, int count);
int is_dear(const System *s);
int judge(double *p, const double *sizes, int done, double *error);
int lingers(const double *p, int done, double left);

/* Dependent rows, see factor.c: epsilon over the largest compliance of one. */
static const double SOFT = 1e-9;

/* Solutions whose rows are softened: n multipliers, complex ones by their parts, and how many corrections they take. ``weight``: of their
   squares in products of forces; ``room``: CLOSING n. ``solve``: the multipliers for rows that are so many times the softness of y open, and,
   to ``keep``, what moves then is added. */
typedef struct {
    int n, corrections;
    const double *weight;
    double *room;
    void (*solve)(void *of, double times, const double *y, double *found, int keep);
    void *of;
} Softened;
void close_softened(const Softened *o, double *y);

/* Parameters of a march; increments of a step at most. */
enum { H, AM, AF, GAMMA, BETA, TOL, FLOOR, CEILING, LENGTH, THETA, SLOW, MAXIT, HISTORY, PATIENCE, NEW_TANGENT, FAR,  /* in */
       ITERATIONS, LOCAL, GUARDED, HIGHEST, TURNOVER, WEIGHT, SHARE, SETTLING, LEFT,                                   /* in and out */
       FEWEST, WASTED, BEGIN_ANEW, WAIT,   /* in and out: schemes/tangent_account.py */
       STABILISED, CHOSEN, EVENS, PARAMETERS }; /* in: the GGL form; sizes by error control; no first step: leaps are evened out */
enum { MOST = 64 };

/* A state as one block of numbers: t, q (nq), v (nv), a (nv), A (nv), lambda (rows), and what a scheme keeps of its own. */
typedef struct {
    double *t, *q, *v, *a, *A, *lam, *own;
} Block;

static inline Block block_at(const System *s, double *x)
{
    Block b;
    b.t = x;
    b.q = x + 1;
    b.v = b.q + s->nq;
    b.a = b.v + s->nv;
    b.A = b.a + s->nv;
    b.lam = b.A + s->nv;
    b.own = b.lam + s->rows;
    return b;
}

/* implicit_schemes.c */
PART int radau_step(System *s, double *p, double *room, const Block *past, int known, Block out);
PART int bdf_step(System *s, double *p, double *room, const Block *past, int known, Block out);

/* elastic_books.c: the books of a step of size h. The step counts. What its record tells of contacts. */
typedef struct ElasticContact ElasticContact;
PART int book_contact(System *s, ElasticContact *o, double h, const Block *now, const Block *out);
PART void pass_contact(ElasticContact *o);
PART void record_contact(const ElasticContact *o, const Block *out, double *to, long place);

/* elastic_contact.c. An increment of Newton's iteration: at t and q its balance is, at ``end`` gaps close, by xi from the step's start at
   ``from`` (s) over a span; forces act by ``scale`` times its solution for the right-hand sides b and ``open``, NULL: the residuals
   evaluated last. */
typedef struct {
    double t, end_t, from, span, scale;
    const double *q, *end, *xi, *open;
    double *b;
} Contacting;
/* Find who takes part in a step of size h, with surfaces paired ``beside`` its start by such an increment, where overlaps stay then, NULL:
   there; begin its iteration, with how many; whether others join in where it has led to. */
PART int begin_contact(System *s, ElasticContact *o, double h, const Block *now, const double *beside);
PART int start_forces(System *s, ElasticContact *o, const Block *now);
PART int met_others(ElasticContact *o, const Block *out, int *verdict);
/* Whether a slow iteration goes on with its matrix: new tangents change nothing but columns of inertia. */
PART int goes_on_slowly(const ElasticContact *o);
/* The matrix is a new one, that of a configuration; the solution with contacts. */
PART void contact_factored(const System *s, ElasticContact *o, const double *q);
PART int contact_increment(System *s, ElasticContact *o, const Contacting *k, double *x, double *y);
/* The error that a first increment of a size (over a tolerance, m) leaves, by what steps before tell; take note of those of a step. */
PART double left_as_told(const ElasticContact *o, const Block *now, double h, double size, double tolerance);
PART void iterated(ElasticContact *o, const Block *now, const Block *out, double h, const double *sizes, double tolerance, int done);
/* Velocities of closed contacts at the end of a step: as persistency in contact_alpha.py, with what accelerations change by for that of a
   velocity. */
typedef struct {
    double h, scale, gain, to_A, to_a;
} Persisting;
PART int persist(System *s, ElasticContact *o, const Persisting *k, const Block *now, const Block *out);
enum { WORKS = 5 }; /* of contacts since the start, see sensors/contact.py: in records of such steps */

/* schemes.c */
void predictor(const Block *past, int known, double t, double *w);
EXPORT int driver_arrive(System *s, int places, double t, double length, double *q, double *v, double *a, double *lam, double *room);
int correct(System *s, double t, double cd, double ck, const double *q, const double *v, double *a, double *lam, double *room);
EXPORT int driver_correct(System *s, long count, const double *t, const double *weights, const double *q, const double *v, double *a,
                          double *lam, double *room);
EXPORT int driver_close(System *s, int places, double t, double length, double cd, double ck, double *q, double *v, double *room);
EXPORT int driver_least(System *s, int factored, double t, long count, const double *q, double *lam, double *room);

/* the core, for schemes */
int prepare_complex(System *s, const double *q, const double *cd, const double *ck, const double *lam, double t);
void settle_angles(const System *s, double *q);
int turns_freely(const System *s);
void openings(System *s, int anew);
void drift(System *s);
int sample(System *s, double t, double *last);
long sample_size(const System *s);
void keep_sample(const System *s, double *kept, int back);
int recall_sample(System *s, double *kept, double t);
void like_v(const System *s, const double *u, double *x);
void effort_row(System *s, const Batch *k, long i, double *row);
int side_row(System *s, const Batch *k, long i, int side, int *body);
void item_row(System *s, const Batch *k, long i, double factor, double *row);
void all_rows(System *s, const double *mu, double *G);
EXPORT int driver_solve(System *s, long count, const double *q, const double *b, const double *c, double *x, double *y);
EXPORT int driver_columns(System *s, long count, long columns, const double *q, const double *still, const double *b, const double *pz,
                          double *x, double *f);
EXPORT int driver_balances(System *s, long count, const double *t, const double *q, const double *v, const double *a,
                           const double *lam, double *out);
EXPORT int driver_constraints(System *s, long count, const double *t, const double *q, const double *v, double *gap, double *slip,
                              double *partial, double *second);
EXPORT int driver_energies(System *s, long count, const double *t, const double *q, const double *v, double *out);
EXPORT int driver_work(System *s, double t, const double *q, const double *v, const double *xi, double *work);
EXPORT int driver_compose(System *s, long count, const double *q0, long step, const double *xi, long xi_step, double *q);
EXPORT void driver_rate(const System *s, long count, const double *xi, long step, const double *v, long v_step, double *rates);
EXPORT void driver_difference(const System *s, long count, const double *q0, long step, const double *q1, long end_step,
                              const double *near, long near_step, double *xi);
int acting(System *s, const double *lam, double t);
const double *known_ahead(const System *s, const Batch *k, const double *seen, double t);
int foretell_points(System *s, long count, const double *t, int each, const double *q, const double *xi, const double *v, const double *a,
                    double *room);
int body_forces(System *s, const double *q, const double *v, const double *a, double t);
void derivatives_in_time(System *s, double *partial, double *second);
int efforts(System *s, Batch *k, double t);
static const double LEFT_OF_PLACES = 3.6e-15; /* share of places that increments may be roundoff of */
double far_from_origin(const System *s, const double *q, double length);
void formula(Batch *k, long i, double t);
typedef int Law(System *s, Batch *k, const void *how, double t); /* N of a batch at its s and s', and slopes of formulas */
int ask_iterate(System *s, Batch *k, Law *law, const void *how, double t);
int ask_slopes(System *s, Batch *k, double t);
int take_slopes(System *s, Batch *k, double t);
int control_effort(System *s, Batch *k, double t);
const double *read_all(const System *s);
static const double OF_THE_LAW = 0.1; /* share of N that a change worth looking at is of */
static const double BENDS = 0.03;     /* share by which slopes of a law differ that bends */

/* The steeper of two slopes that differ, else 0. */
static inline double steeper(double one, double other)
{
    const double steepest = fabs(other) > fabs(one) ? other : one;
    return fabs(one - other) > BENDS * fabs(steepest) ? steepest : 0.0;
}

/* The line of item i at a point of a step. */
static inline double *line_of(const Batch *k, int point, long i) { return k->line + LINE * (point * k->n + i); }
int undecided(System *s, double unit, const double *x);
enum { HESITATIONS = 3 }; /* increments of a step at most that are made for what it tells */
int increment(System *s, double scale, double *x, double *y, double t);
int items(System *s, Batch *k, const double *lam, double t);
int misled(const System *s);
double other_pulls(System *s, const double *x);
int other_slopes(const System *s, double cd, double ck);
int stabilised(System *s, double scale, double damp, double *x, double *closing, double *y, double *none, double t);
int take_tangents(System *s, const double *x, int predicted, double t);
double typical(const System *s, const double *a);
int with_all_rows(System *s, double scale, double *x, double *y, double t);
int with_fields(System *s, double scale, double *x, double *y, double t);

long place_on(const Tape *tape);
int awaited(const Tape *tape, double t);
int is_full(const Kept *o);
double *keep_between(const System *s, Kept *o, const double *begin, const double *end, double until);
int record(System *s, Tape *tape, const Block *now, const double *known, int judged); /* the core */
void judge_drift(System *s, Tape *tape, const Block *now);

/* Whether the frame of a body rests: that of a field where it was meshed, that of a part on the ground at the origin. */
static inline int rests(const Body *o) { return o->field ? o->field->inertial == 0 : o->told && o->told->rests; }

/* What a part knows of its motion: twist of the frame and its rate (rotations in body axes), pose, the coordinates'. */
typedef struct {
    const double *pose, *twist, *accel, *U, *Ud, *Udd;
} Motion;

static inline Motion motion_of(const Body *o, int b, const double *q, const double *v, const double *a)
{
    Motion m = {q + POSE * b, v + TWIST * b, a + TWIST * b, q + o->at_q, v + o->at_v, a + o->at_v};
    return m;
}

/* Ask Python about the part of this number, with n coordinates, whose motion it finds in ``state``. */
static inline int tell(System *s, int what, int number, long n, double *state, const double *R, const Motion *m,
                       const double *gravity, double t)
{
    const double *parts[8] = {R, m->twist, m->accel, m->pose, gravity, m->U, m->Ud, m->Udd};
    const long sizes[8] = {D * D, TWIST, TWIST, POSE, D, n, n, n};
    for (int i = 0; i < 8; state += sizes[i++]) memcpy(state, parts[i], sizes[i] * sizeof(double));
    s->calls++;
    int told = s->python(what, number, t);
    return told == OUTSIDE ? NEWTON : told ? FAILED : DONE;
}

/* The coordinates of a body's modes. */
static inline const double *modes_of(const Body *o, const double *q)
{
    return o->field ? o->field->p : q + o->at_q;
}
