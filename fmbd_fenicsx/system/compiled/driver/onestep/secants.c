/* What the increments of a step tell of the terms that its tangent leaves out: the algorithm, and the names, of
   schemes/onestep/alpha/secants.py.

   A vector holds x (nv), the correction of the stabilised form (nv), y (rows); the first two are compared as lengths. */

enum { PAIRS = 10, LEARNT = 4 };       /* at most; those without which the rate tells nothing of the tangent */
static const double POOR = 0.1;        /* an increment of the tangent, over the one made before, above which pairs are used */
static const double ALIKE = 1e-6;      /* share of an image that the earlier ones do not have, below which it tells nothing */

typedef struct {
    int count, poor, known;            /* known: whether there is an increment before */
    double *last, *made, *pair;        /* the tangent's newest increment, the one that was made, then p and d of each pair */
    double size;                       /* length of the one that was made */
} Secants;

static void forget(Secants *k) { k->count = k->poor = k->known = 0; }

static int learning(const Secants *k) { return k->poor && k->count < LEARNT; }

/* The product of two vectors as lengths. */
static double lengths_dot(const System *s, const double *a, const double *b)
{
    double sum = 0.0;
    for (int i = 0; i < s->nv; i++) sum += s->units[i] * s->units[i] * (a[i] * b[i] + a[s->nv + i] * b[s->nv + i]);
    return sum;
}

static double length_of(const System *s, const double *x, const double *closing)
{
    double size = largest_of(s->units, x, s->nv), closed = closing ? largest_of(s->units, closing, s->nv) : 0.0;
    return closed > size ? closed : size;
}

/* One more pair: the increment made changed that of the tangent from last to f. */
static void learn(const System *s, Secants *k, const double *f)
{
    const int w = 2 * s->nv + s->rows;
    if (k->count == PAIRS) k->count = 0;
    double *p = k->pair + 2 * w * k->count, *d = p + w;
    memcpy(p, k->made, w * sizeof(double));
    for (int i = 0; i < w; i++) d[i] = k->last[i] - f[i];
    double whole = sqrt(lengths_dot(s, d, d));
    for (double *o = k->pair; o < p; o += 2 * w) {
        double share = lengths_dot(s, o + w, d);
        add(p, -share, o, w);
        add(d, -share, o + w, w);
    }

    double size = sqrt(lengths_dot(s, d, d));
    if (!(size > ALIKE * whole && size < INFINITY)) return;
    for (int i = 0; i < 2 * w; i++) p[i] /= size;
    k->count++;
}

/* (1) for the tangent's increment x, closing (NULL: none), y; in place. */
static void improve(const System *s, Secants *k, double *x, double *closing, double *y)
{
    const int n = s->nv, w = 2 * n + s->rows;
    double *f = k->pair + 2 * w * PAIRS;
    memcpy(f, x, n * sizeof(double));
    if (closing) memcpy(f + n, closing, n * sizeof(double));
    else memset(f + n, 0, n * sizeof(double));
    memcpy(f + 2 * n, y, s->rows * sizeof(double));
    double size = length_of(s, x, closing);
    if (k->known && size > POOR * k->size) k->poor = 1;

    if (k->poor && k->known) {
        learn(s, k, f);
        memcpy(k->made, f, w * sizeof(double));
        for (const double *p = k->pair; p < k->pair + 2 * w * k->count; p += 2 * w) {
            double share = lengths_dot(s, p + w, f);
            for (int i = 0; i < w; i++) k->made[i] += share * (p[i] - p[w + i]);
        }

        memcpy(x, k->made, n * sizeof(double));
        if (closing) memcpy(closing, k->made + n, n * sizeof(double));
        memcpy(y, k->made + 2 * n, s->rows * sizeof(double));
        size = length_of(s, x, closing);
    } else memcpy(k->made, f, w * sizeof(double));
    memcpy(k->last, f, w * sizeof(double));
    k->known = 1;
    k->size = size;
}
