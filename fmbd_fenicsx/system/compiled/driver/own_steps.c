/* Steps whose sizes error control chooses: where they end, the sizes of the norm of schemes/error_norm.py, and what follows a step that is
   refused. A step that fails in another way than by its error is made once more by Python, from the same beginning. */

typedef struct OwnSteps {
    int index, places, deforming, patience; /* of the form; whether it holds places; bodies that deform; errors that refuse one step */
                                       /* before Python makes it */
    Deflection *deflection;
    double *sizes, *speeds, *scale;    /* largest so far, of coordinates and velocities; work; each like v */
    double rtol, atol, length, turn;
    double safety, harsh, mild;        /* of a refused step: least and most that is left of its size */
    double first, places_of_decade, longer; /* where sizes keep to a grid: one of them, 0: any size will do; how many of a decade; what */
                                       /* a step may be longer than proposed */
    double until, longest, last, tiny; /* a time that is hit; the most a step may be; until when steps may begin; a size that is too */
                                       /* small; s */
    double worst, refused;             /* of a march: the largest error, and how many were too large */
    double turning, order, shrink, grow, least, most; /* of Radau: steps are to turn by so much less; of the controller; least */
                                       /* error that it remembers; increments, twice */
    const double *error;               /* of its tableau */
    struct Orders *orders;             /* of BDF */
} OwnSteps;

/* A step on its way to one that passes: the size that is proposed, the error of the newest try over the tolerance, and how many such
   errors have refused it so far. */
typedef struct {
    double proposed, error;
    int refused;
} Passing;

/* The most that the next step from a state on may be, s. */
static double left_for(const OwnSteps *c, const Block *now) { return fmin(c->until - *now->t, c->longest); }

/* The size of the next step from a state on, where so much is proposed and no more than ``most`` possible; 0: it is none. */
static double own_size(const OwnSteps *c, const Block *now, double proposed, double most)
{
    const double left = left_for(c, now);
    double h = fmin(proposed, most);
    if (c->first > 0.0) h = c->first * pow(10.0, floor(c->places_of_decade * log10(c->longer * h / c->first)) / c->places_of_decade);
    if (h >= left * (1.0 - 1e-10)) h = left;
    else if (h > 0.5 * left) h = 0.5 * left;
    return *now->t + h == *now->t ? 0.0 : h;
}

/* By how much a step with this error over the tolerance may grow, where errors fall like h^order. */
static double growth_factor(double error, double order, double safety) { return safety * pow(error, -1.0 / order); }

/* Propose a size after one that its error has refused, that of a method of this order; 0: Python has to say what is wrong. */
static int refused_size(const OwnSteps *c, const Block *now, double h, double order, Passing *found)
{
    const double next = h * fmin(fmax(growth_factor(found->error, order, c->safety), c->harsh), c->mild);
    found->proposed = next;
    return ++found->refused <= c->patience && found->error < INFINITY && next >= c->tiny && *now->t + 0.01 * next != *now->t;
}

/* Take note of a step that has passed. */
static void note_passing(OwnSteps *c, const Passing *found)
{
    c->worst = fmax(c->worst, found->error);
    c->refused += found->refused;
}

/* Whether what has failed is tried once more: the tangent was that of an older step. */
static int tried_anew(const Implicit *o, int verdict, double *work)
{
    if (o->fresh || (verdict != NEWTON && verdict != SINGULAR)) return 0;
    work[KNOWN] = 0.0;
    return 1;
}

/* The largest step of which ``turning`` together turn none of so many frames in space by more than ``turn`` (rad), as it moves now. */
double farthest_turn(int frames, double turn, double turning, const Block *now)
{
    double fastest = 0.0;
#if DIM == 3
    for (int b = 0; b < frames; b++) {
        const double *w = now->v + TWIST * b + D, *e = now->a + TWIST * b + D;
        double square = dot(w, w, 3);
        fastest = fmax(fastest, sqrt(square) + sqrt(square + 2.0 * sqrt(dot(e, e, 3)) * turn / turning));
    }
#else
    (void)frames, (void)now;
#endif
    return fastest > 0.0 ? 2.0 * turn / (turning * fastest) : INFINITY;
}

/* Whether increments of the points come close to a full turn of a frame in space. */
static int turn_too_far(const System *s, const OwnSteps *c, const Stages *g)
{
#if DIM == 3
    for (int j = 0; j < g->points; j++)
        for (int b = 0; b < s->bodies; b++) {
            const double *turn = g->xi + (long)j * g->n + TWIST * b + D;
            if (!(dot(turn, turn, 3) <= 4.0 * c->turn * c->turn)) return 1;
        }
#else
    (void)s, (void)c, (void)g;
#endif
    return 0;
}

/* Sizes so far, with those of a state before a step of h, and what errors are multiplied by in the norm. */
static void take_sizes(const System *s, const OwnSteps *c, Stages *g, const Block *now, double h)
{
    g->span = h;
    const int n = g->fields ? g->fields->span[0] : g->n, every = g->n; /* fields count by what they bend */
    double *scale = c->scale, fastest[2] = {0.0, 0.0};
    position_sizes(s, c->length, now->q, scale);
    for (int i = 0; i < n; i++) {
        double speed = fmax(fabs(now->v[i]), h * fabs(now->a[i]));
        scale[i] = c->sizes[i] = fmax(c->sizes[i], scale[i]);
        if (i < TWIST * s->bodies) fastest[i % TWIST >= D] = fmax(fastest[i % TWIST >= D], speed);
        else c->speeds[i] = fmax(c->speeds[i], speed);
    }
    for (int i = 0; i < TWIST * s->bodies; i++) c->speeds[i] = fmax(c->speeds[i], fastest[i % TWIST >= D]);

    for (int i = 0; i < n; i++) {
        double place = c->rtol * scale[i] + c->atol, rate = c->rtol * c->speeds[i] + 1e-4 * place / h;
        g->weigh[i] = 1.0 / place;
        g->weigh[every + i] = c->index == 3 ? h / place : 1.0 / rate;
        g->weigh[2 * every + i] = c->index == 3 ? h * h / place : h / rate;
    }
    for (Deflection *x = c->deflection; x < c->deflection + c->deforming; x++) {
        x->size = fmax(x->size, 1e-2 * c->length);
        for (int i = 0; i < x->n; i++) x->size = fmax(x->size, fabs(now->q[x->at_q + i]) * (x->rms ? x->rms[i] : 1.0));
        for (int i = 0; i < x->n; i++) {
            double place = c->rtol * x->size / (x->rms ? x->rms[i] : 1.0) + c->atol, *w = g->weigh + x->at_v + i;
            w[0] = 1.0 / place;
            w[every] = h / place;
            w[2 * every] = h * h / place;
        }
    }
}

/* The largest of the weighted root mean squares of errors of places, of rates and of what is ``parts[2]``; of so many kinds. */
static double own_norm(const System *s, const Stages *g, const double *const *parts, int kinds)
{
    double worst = 0.0;
    for (int i = 0; i < kinds; i++) {
        double one = mean_square(s, g, i, parts[i]);
        if (!(one <= worst)) worst = one; /* nan stays */
    }
    return sqrt(worst);
}
