/* Norms of increments and errors, schemes/error_norm.py: what they are weighed by, and their means. */

/* What x like v is multiplied by. */
typedef struct {
    int n, parts;                      /* entries like v; how many parts of these count by themselves: the core, and every field */
    const int *span, *counted;         /* where each of them ends, the core first; how many of it move */
    double *weigh;                     /* 3 x n: of places, of rates, and of accelerations */
    double *bases, *bent, h;           /* of rods and frames whose deformations are weighed apart, NULL: see bend(); n; s, of the step */
} Norm;

#include "marches/rigid_motions.c"

/* By how much n coordinates of one kind are moved, ``least`` of which all are at least; ``unit``: what makes them lengths. */
static void own_sizes(int n, const double *unit, const double *x, double share, double least, double factor, double *h)
{
    least = share * fmax(largest_of(unit, x, n), least);
    for (int i = 0; i < n; i++) h[i] = factor * fmax(unit[i] * fabs(x[i]), least) / (unit[i] > 0.0 ? unit[i] : 1.0);
}

/* Sizes of coordinates: as Sizes.positions() of system/tangents/linearise.py. */
static void position_sizes(const System *s, double length, const double *q, double *sizes)
{
    for (int b = 0; b < s->bodies; b++) {
        const Body *o = s->body + b;
        for (int i = 0; i < TWIST; i++) sizes[TWIST * b + i] = i < D ? length : 1.0;
        if (o->modes && !o->field) own_sizes(o->modes, s->units + o->at_v, q + o->at_q, 1e-3, 1e-3 * length, 1.0, sizes + o->at_v);
    }
}

/* The weighted mean square of what is of one of the three kinds, 0 to 2, of the part where it is largest; that of deformations where
   these are weighed apart and have a larger one. */
static double mean_square(const System *s, const Norm *o, int kind, const double *x)
{
    const double *weigh = o->weigh + (long)kind * o->n, power = kind > 1 ? o->h * o->h : o->h;
    const int apart = o->bases && kind;
    double worst = 0.0;
    if (apart) bend(s, o, x, o->bent);
    for (int k = 0, i = 0; k < o->parts; k++) {
        double sum = 0.0, of_bent = 0.0;
        for (; i < o->span[k]; i++) {
            double bent = apart ? o->bent[i] : 0.0, e = weigh[i] * (x[i] - bent), b = power * o->weigh[i] * bent;
            sum += e * e;
            of_bent += b * b;
        }

        if (o->counted[k]) worst = worse(worst, worse(sum, of_bent) / o->counted[k]);
    }
    return worst;
}

/* The largest of the weighted root mean squares of errors of places, of rates and of what is ``parts[2]``; of so many kinds. */
static double own_norm(const System *s, const Norm *o, const double *const *parts, int kinds)
{
    double worst = 0.0;
    for (int i = 0; i < kinds; i++) worst = worse(worst, mean_square(s, o, i, parts[i]));
    return sqrt(worst);
}
