/* Steps whose sizes error control chooses: where they end, the sizes of the norm of schemes/error_norm.py, and what follows a step that is
   refused. A step that fails in another way than by its error is made once more by Python, from the same beginning. */

/* Why a try at a step has no end: its iteration diverges, is too slow, frames turn too far. */
enum { DIVERGES, IS_SLOW, TURNS_FAR, FAILING };

typedef struct OwnSteps {
    int index, places, deforming, patience; /* of the form; whether it holds places; bodies that deform; errors that refuse one step */
                                       /* before Python makes it */
    Deflection *deflection;
    double *sizes, *speeds, *scale;    /* largest so far, of coordinates and velocities; work; each like v */
    double rtol, atol, length, turn, brief; /* share of the tolerance of places by which velocities of a step may be off over its size */
    double safety, harsh, mild;        /* of a refused step: least and most that is left of its size */
    double first, places_of_decade, longer; /* where sizes keep to a grid: one of them, 0: any size will do; how many of a decade; what */
                                       /* a step may be longer than proposed */
    double until, longest, last, tiny; /* a time that is hit; the most a step may be; until when steps may begin; a size that is too */
                                       /* small; s */
    const double *mark;                /* times on the way there that are hit, too, rising (s); how many, and how many were passed */
    int marks, passed;
    double ahead;                      /* the next of all these, s */
    double given;                      /* whether steps end at these times alone, whatever their errors are */
    double sample;                     /* when a controller samples: who takes the sample makes the step that ends there, s */
    double worst, refused, filtered;   /* of a march: the largest error, how many were too large, and by how many solutions */
    double failed[FAILING];            /* how many tries at a step had no end, by cause */
    double order, shrink, grow, least; /* of the controller; least error that it remembers */
    double pause, since;               /* steps on a grid behind a failure that do not grow, twice as many where one comes soon again; steps since */
    double turning, most;              /* of Radau: steps are to turn by so much less; increments, twice */
    double trouble, troubled;          /* of Radau: two for each failure of late, less one for each step; with more Python makes the step */
    const double *error;               /* weights of slopes, or of Radau's stages, in the error */
    const double *between;             /* of Radau, where it looks between stages too: see _between() of collocation.py; or NULL */
    struct Orders *orders;             /* of BDF */
} OwnSteps;

/* A step on its way to one that passes: the size that is proposed, the error of the newest try over the tolerance, and how many such
   errors have refused it so far, by how many solutions they were found, how often it had no end, and by cause. */
typedef struct {
    double proposed, error;
    int refused, filtered, failures, failed[FAILING];
} Passing;

static const double MISSED = 1e-14; /* share of a time by which a step may miss it */

/* The most that the next step from a state on may be, s, up to the next time that is hit, which is known then. */
static double left_for(OwnSteps *c, const Block *now)
{
    while (c->passed < c->marks && c->mark[c->passed] * (1.0 - MISSED) <= *now->t) c->passed++;
    c->ahead = c->passed < c->marks ? c->mark[c->passed] : c->until;
    return fmin(c->ahead - *now->t, c->longest);
}

/* The size of the next step from a state on, where so much is proposed and no more than ``most`` possible. What is left to the time
   that is hit is no step of its own where it is roundoff. NEWTON where there is none, SIZE where Python makes that step, or says
   that a given one is too large. */
static int own_size(const OwnSteps *c, const Block *now, double proposed, double most, double *size)
{
    const double left = c->ahead - *now->t;
    double h = fmin(proposed, most);
    if (c->first > 0.0) h = c->first * pow(10.0, floor(c->places_of_decade * log10(c->longer * h / c->first)) / c->places_of_decade);
    h = fmin(h, c->longest);
    if (h >= left * (1.0 - 1e-10)) h = left;
    else if (c->given != 0.0) return SIZE;
    else if (h > 0.5 * left) h = 0.5 * left;
    *size = h;
    if (*now->t + h == *now->t) return NEWTON;
    return *now->t + h >= c->sample ? SIZE : DONE;
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

enum { FAILURES = 4 }; /* of one step that the iteration finds no end of, before Python makes it, which says what is wrong */

/* Propose a size after such a failure; 0: Python has to make this step. */
static int failed_size(const OwnSteps *c, double h, int cause, Passing *found)
{
    if (c->given != 0.0) return 0;
    found->proposed = 0.5 * h;
    found->failed[cause]++;
    found->failures++;
    return c->troubled > 0.0 ? c->trouble + 2 * found->failures <= c->troubled : found->failures <= FAILURES;
}

/* What the controller of a step keeps with its end: the size that it proposes, its own size (0: there is none), the error that it
   remembers. */
typedef struct {
    double next, before, missed;
} Controlled;

enum { CONTROLLED = 3 };
static const double NO_ERROR = 1e-10; /* smaller ones are none */

/* The size that follows an accepted step of h that was noted: accepted() of schemes/control.py, with the same ``effort``. */
static double accepted_size(const OwnSteps *c, const Controlled *last, Controlled *made, double h, const Passing *found, double effort)
{
    const double known = fmax(found->error, NO_ERROR), safety = c->safety;
    double factor = growth_factor(known, c->order, safety * effort);
    if (last->before > 0.0) factor = fmin(factor, safety * (h / last->before) * pow(last->missed / (known * known), 1.0 / c->order));
    made->before = h;
    made->missed = fmax(known, c->least);
    return h * fmin(fmax(factor, c->shrink), found->refused || found->failures || c->since < c->pause ? 1.0 : c->grow);
}

/* Whether a try at a step passes. */
static int lets_pass(const OwnSteps *c, const Passing *found) { return found->error <= 1.0 || (c->given != 0.0 && found->error < INFINITY); }

/* The size that is proposed first, where a controller proposes so much. */
static double proposal(const OwnSteps *c, double next) { return c->given != 0.0 ? INFINITY : next; }

static const double LONG_PAUSE = 4.0; /* of growth, steps: the least behind a second failure */

/* Take note of a step that has passed. */
static void note_passing(OwnSteps *c, const Passing *found)
{
    c->worst = fmax(c->worst, found->error);
    c->refused += found->refused;
    c->filtered += found->filtered;
    c->since += 1.0;
    if (found->failures && c->first > 0.0) {
        c->pause = c->since <= 2.0 * c->pause ? fmax(2.0 * c->pause, LONG_PAUSE) : 1.0;
        c->since = 0.0;
    }
    c->trouble = fmax(c->trouble + 2 * found->failures - 1, 0.0);
    for (int i = 0; i < FAILING; i++) c->failed[i] += found->failed[i];
}

/* The largest step of which ``turning`` together turn none of so many frames in space by more than ``turn`` (rad), as it moves now. */
static double farthest_turn(int frames, double turn, double turning, const Block *now)
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

/* Whether so many increments xi, like v, come close to a full turn of a frame in space. */
static int turn_too_far(const System *s, const OwnSteps *c, int count, const double *xi)
{
#if DIM == 3
    for (int j = 0; j < count; j++)
        for (int b = 0; b < s->bodies; b++) {
            const double *turn = xi + (long)j * s->nv + TWIST * b + D;
            if (!(dot(turn, turn, 3) <= 4.0 * c->turn * c->turn)) return 1;
        }
#else
    (void)s, (void)c, (void)count, (void)xi;
#endif
    return 0;
}

/* The largest deformation of a body so far, m, with that of a state. */
static double deflected(const OwnSteps *c, const Deflection *x, const double *q)
{
    double size = fmax(x->size, 1e-2 * c->length);
    for (int i = 0; i < x->n; i++) size = fmax(size, fabs(q[x->at_q + i]) * (x->rms ? x->rms[i] : 1.0));
    return size;
}

/* Sizes so far, with those of a state before a step of this norm, and what errors are multiplied by in the norm. */
static void take_sizes(const System *s, const OwnSteps *c, const Norm *o, const Block *now)
{
    const int n = o->span[0], every = o->n; /* fields count by what they bend */
    const double h = o->h;
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
        double place = c->rtol * scale[i] + c->atol, rate = c->rtol * c->speeds[i] + c->brief * place / h;
        o->weigh[i] = 1.0 / place;
        o->weigh[every + i] = c->index == 3 ? h / place : 1.0 / rate;
        o->weigh[2 * every + i] = c->index == 3 ? h * h / place : h / rate;
    }

    for (Deflection *x = c->deflection; x < c->deflection + c->deforming; x++) {
        x->size = deflected(c, x, now->q);
        for (int i = 0; i < x->n; i++) {
            double place = c->rtol * x->size / (x->rms ? x->rms[i] : 1.0) + c->atol, *w = o->weigh + x->at_v + i;
            w[0] = 1.0 / place;
            w[every] = h / place;
            w[2 * every] = h * h / place;
        }
    }
}
