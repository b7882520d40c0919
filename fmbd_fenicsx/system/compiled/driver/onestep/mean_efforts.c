/* Efforts over a step of the energy-momentum scheme, mean.c: means of their laws, along rows that are difference quotients. */

/* Where coordinates of efforts begin, and room for four numbers each. */
typedef struct {
    const double *from;
    double *room;
} Mean;

/* Means of N over a step whose middle is at s, at the mean rate, and slopes of formulas; Python takes the mean of all three points in one
   call. */
static int law_of_step(System *s, Batch *k, const void *how, double t)
{
    const Mean *o = how;
    const long n = k->n;
    if (k->act) return control_effort(s, k, t);

    double *middle = o->room, *sum = middle + n, *slope = sum + n, *drag = slope + n;
    memcpy(middle, k->s, n * sizeof(double));
    memset(sum, 0, 3 * n * sizeof(double));
    for (int g = 0; g < 3 && k->role == FORMULA; g++) {
        for (long i = 0; i < n; i++) {
            k->s[i] = o->from[i] + 2.0 * GAUSS[g] * (middle[i] - o->from[i]);
            formula(k, i, t);
        }

        add(sum, SHARES[g], k->effort, n);
        add(slope, 2.0 * GAUSS[g] * SHARES[g], k->stiffness, n);
        add(drag, SHARES[g], k->damping, n);
    }

    if (k->role == FORMULA) {
        memcpy(k->effort, sum, n * sizeof(double));
        memcpy(k->stiffness, slope, n * sizeof(double));
        memcpy(k->damping, drag, n * sizeof(double));
    } else {
        for (long i = 0; i < n; i++) k->s[i] = o->from[i];
        s->calls++;
        if (s->python(EFFORT_MEANS, k->number, t)) return FAILED;
    }
    memcpy(k->s, middle, n * sizeof(double));
    return DONE;
}

/* The share of rows with h rows . twist = s_1 - s_0; the kernel's answers at the mean are there. */
static void mean_shares(System *s, const Batch *k, const Step *o, long first)
{
    const double *from = o->s[0] + first, *to = o->s[1] + first, *out = k->out;
    const int *at = k->at;
    double *share = o->share + first;
    for (long i = 0; i < k->n; i++, out += k->outputs, at += k->live) {
        double linear = 0.0, whole = 0.0;
        for (int e = 0; e < k->live; e++) {
            double row = out[k->entry[e]], unit = k->component[k->entry[e] - 1] % TWIST < D ? o->length : 1.0;
            linear += o->h * row * s->velocity[at[e]];
            whole = fmax(whole, fabs(unit * row));
        }

        share[i] = 1.0;
        if (k->quotient == DISTANCE) share[i] = 2.0 * out[0] / (from[i] + to[i]);
        int far = fabs(linear) > fmax(UNMOVED * whole, UNKNOWN * fabs(to[i]));
        if (k->quotient == QUOTIENT && far) share[i] = fmax(-10.0, fmin((to[i] - from[i]) / linear, 10.0));
    }
}

/* Efforts N as means of the law from s_0 to s_1 at the mean rate, times the share of their rows. */
static int mean_efforts(System *s, Batch *k, const Step *o, long first, double t)
{
    const double *from = o->s[0] + first, *to = o->s[1] + first, *share = o->share + first;
    double *sum = o->effort + first;
    mean_shares(s, k, o, first);
    for (long i = 0; i < k->n; i++) {
        k->rate[i] = (to[i] - from[i]) / o->h;
        sum[i] = 0.0;
    }

    for (int g = 0; g < 3 && k->role == LINEAR; g++) {
        for (long i = 0; i < k->n; i++) {
            k->s[i] = from[i] + GAUSS[g] * (to[i] - from[i]);
            k->effort[i] = k->stiffness[i] * (k->s[i] - k->free[i]) + k->damping[i] * k->rate[i];
        }
        add(sum, SHARES[g], k->effort, k->n);
    }

    if (k->role == FORMULA || k->role == LAW) {
        const Mean mean = {from, o->means};
        for (long i = 0; i < k->n; i++) k->s[i] = 0.5 * (from[i] + to[i]);
        if (ask_iterate(s, k, law_of_step, &mean, t)) return FAILED;
    }
    if (k->role != LINEAR) memcpy(sum, k->effort, k->n * sizeof(double));
    for (long i = 0; i < k->n; i++) sum[i] *= share[i];
    return DONE;
}

/* Forces of one batch into the residuals, at the mean; rows are the kernel's last answers. */
static int mean_items(System *s, Batch *k, const Step *o, long first, const double *lam, double t)
{
    const int exact = k->quotient != POINT;
    int verdict;
    if (k->role == MOUNT || k->role == WHOLE || k->role == READ || (k->role == TERM && !exact)) return items(s, k, lam, t);

    if (k->role != ROW) {
        if (k->terms && exact) add_terms(k, o->share + first - k->terms * k->n); /* which have had their turn */
        else values(s, k);
        if (k->role == TERM) {
            mean_shares(s, k, o, first);
            return DONE;
        }
        verdict = exact ? mean_efforts(s, k, o, first, t) : k->role != GIVEN ? efforts(s, k, t) : DONE;
        if (verdict) return verdict;
    }

    const double *out = k->out, *effort = exact ? o->effort + first : k->effort;
    const int *at = k->at;
    for (long i = 0; i < k->n; i++, out += k->outputs, at += k->live) {
        double force = k->role == ROW ? k->factor[i] * lam[k->row[i]] : effort[i];
        for (int e = 0; e < k->live; e++) s->residual[at[e]] += force * out[k->entry[e]];
    }
    return DONE;
}
