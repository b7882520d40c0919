/* How a field leaves the step's matrix: (2) of fields.c. That matrix may be complex, of stages of implicit schemes; factors, columns and
   right-hand sides then have two parts, all real numbers first and all imaginary ones behind them. */

static const double HELD = 1e100; /* stiffness of columns that do not move, so that the others see none of it */

/* The rows of a moving frame in the block A (n columns) of (2), and T. */
static void frame_block(const Body *o, const double *R, double *A, int n)
{
    const Field *e = o->field;
    turning_rows(R, e->moment, e->inertia, A, n);
    for (int i = 0; i < D; i++) A[(n + 1) * i] = o->mass;
    if (e->second) stiffened_block(e, R, A, n);
    for (int i = 0; i < D; i++)
        for (int j = 0; j < D; j++) A[n * (TWIST + i) + j] = R[D * j + i];
    for (int i = 0; i < ROT; i++)
        for (int j = 0; j < ROT; j++) A[n * (TWIST + D + i) + D + j] = DIM == 3 ? R[D * j + i] : 1.0;
}

/* The rotation T of the factor: that of the body since the tangent was taken. 1 where there is none. */
static int turn_factor(const Field *e, const double *U)
{
    double turn[D * D];
    if (mean_turn(e, U, turn)) return 1;
    for (int i = 0; i < D; i++) /* turn: R^T */
        for (int j = 0; j < D; j++) {
            e->T[D * i + j] = 0.0;
            for (int k = 0; k < D; k++) e->T[D * i + j] += turn[D * k + i] * e->began[D * j + k];
        }
    return 0;
}

/* x (n vectors) = T y, or T^T y where ``back``; in place. */
static void turn_nodes(const Field *e, double *x, long n, int back)
{
    double y[D];
    for (long i = 0; e->turns && i < n; i += D) {
        memcpy(y, x + i, sizeof y);
        if (back) transposed(e->T, y, x + i);
        else times(e->T, y, x + i);
    }
}

/* The lower half of the block of (2) into the fronts, or of its imaginary part; the frame conditions, solved already, get rows of their
   own: without a weight, as they must not tell how soft the rows of joints are where these depend on each other. 1 where a body has
   no rotation. */
int field_block(System *s, const Body *o, const double *R, const double *q)
{
    const Field *e = o->field;
    int n = TWIST + o->modes;
    double *A = o->block, *S = A + n * TWIST + TWIST, *stiffness = e->S + (long)s->imaginary * e->solved * e->solved;
    memset(A, 0, (size_t)n * n * sizeof(double));
    if (e->sways) mass_times(e, q + o->at_q, e->MU);
    for (int i = 0; rests(o) && !s->imaginary && i < TWIST; i++) A[(n + 1) * i] = o->mass;
    if (!rests(o) && !s->imaginary) frame_block(o, R, A, n);

    if (e->turns && turn_factor(e, q + o->at_q)) return 1;
    for (int i = 0; i < e->solved; i++) memcpy(S + n * i, stiffness + e->solved * i, e->solved * sizeof(double));
    for (int i = e->solved; i < o->modes && !s->imaginary; i++) S[(n + 1) * i] = HELD;
    for (int i = 0; e->turns && i < e->solved; i++) turn_nodes(e, S + n * i, e->solved, 0); /* S T^T, then T S T^T */
    for (int i = 0; e->turns && i < e->solved; i += D)
        for (int j = 0; j < e->solved; j++) {
            double y[D], x[D];
            for (int k = 0; k < D; k++) y[k] = S[n * (i + k) + j];
            times(e->T, y, x);
            for (int k = 0; k < D; k++) S[n * (i + k) + j] = x[k];
        }

    const int *dest = o->dest;
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) s->L[*dest++] += A[n * i + j];
        s->diagonal[o->at_u + i] = fabs(A[(n + 1) * i]);
    }
    for (int i = 0; i < e->frames && !s->imaginary; i++) s->L[s->row_dest[e->row + i]] -= 1.0;
    return 0;
}

/* x = (L D L^T)^-1 b for complex numbers, b and x by their parts. */
static void symmetric_solve(const Symmetric *o, const double *b, double *x)
{
    const long n = o->n;
    const double complex *L = (const double complex *)o->L, *inverse = (const double complex *)o->inverse;
    double complex *y = (double complex *)o->work;
    for (long i = 0; i < n; i++) y[i] = CMPLX(b[o->order[i]], b[n + o->order[i]]);
    for (long k = 0; k < n; k++) {
        const double complex c = y[k];
        for (int p = o->start[k]; p < o->start[k + 1]; p++) y[o->row[p]] -= L[p] * c;
        y[k] = c * inverse[k];
    }

    for (long k = n - 1; k >= 0; k--) {
        double complex sum = 0.0;
        for (int p = o->start[k]; p < o->start[k + 1]; p++) sum += L[p] * y[o->row[p]];
        y[k] -= sum;
        x[o->order[k]] = creal(y[k]);
        x[n + o->order[k]] = cimag(y[k]);
    }
}

/* One part of (c_0 + i c_1) z, ``count`` numbers. */
static void scaled(const Field *e, int part, const double *c, long count, double *x)
{
    const double *z = e->z + part * e->wide, *other = e->z + (1 - part) * e->wide, across = part ? c[1] : -c[1];
    for (long i = 0; i < count; i++) x[i] = c[0] * z[i];
    for (long i = 0; e->parts > 1 && i < count; i++) x[i] += across * other[i];
}

/* One part of the residual E z - b, by nodes and by the rows of a pressure. */
static void take_residual(const Field *e, int part)
{
    const NodeMatrix K = {e->K_start, e->K_column, e->tangent};
    const double *b = e->b + part * e->wide;
    double *x = e->elastic, *r = e->left + part * e->wide;
    memset(r, 0, e->wide * sizeof(double));
    add(r, -1.0, b, e->n);
    scaled(e, part, e->of_mass, e->n, x);
    add_mass(e, x, r);

    for (int j = 0; !e->by_component && j < DAMPINGS; j++) {
        if (!e->damping[j]) continue;
        scaled(e, part, e->of_damping + 2 * j, e->n, x);
        blocks_times(e->nodes, e->damping[j], x, x, 0.0, r);
    }

    if (!e->by_component) {
        scaled(e, part, e->of_stiffness, e->wide, x);
        blocks_times(e->nodes, &K, x, x, 0.0, r);
        for (int i = 0; e->droppers && i < e->droppers->count; i++)
            if (e->droppers->slack[i]) pull_nodes(e->droppers, i, -e->droppers->stiffness[i] * stretch(e->droppers, i, x), r);
        if (e->pressure) pressure_residual(e->pressure, x, x + e->n, r, r + e->n);
    }
}

/* z = (of_mass M)^-1 b, one component after another; 1 where there is none. */
static int by_components(const Field *e)
{
    for (int j = 0; j < D; j++) {
        for (long i = 0; i < e->nodes; i++) e->one_b[i] = e->b[D * i + j] / e->of_mass[0];
        if (e->direct(*e->factor, e->one_rhs, e->one_solution)) return 1;
        for (long i = 0; i < e->nodes; i++) e->z[D * i + j] = e->one_z[i];
    }
    return 0;
}

/* z = E^-1 b by the factor, unrefined; 1 where there is none. ``b``, ``z`` and the vectors on them: those of the field, or of a residual. */
static int by_factor(const Field *e, const double *b, double *z, void *rhs, void *solution)
{
    if (e->parts == 1) return e->direct(*e->factor, rhs, solution);
    symmetric_solve(*e->factor, b, z);
    return 0;
}

/* The same, once more for what is left of volumes: pressures that are unknowns answer to it with the bulk modulus. */
static int refined(const Field *e)
{
    if (e->by_component) return by_components(e);
    if (by_factor(e, e->b, e->z, e->rhs, e->solution)) return 1;
    if (!e->more) return 0;
    for (int part = 0; part < e->parts; part++) take_residual(e, part);
    if (by_factor(e, e->left, e->more, e->residual, e->change)) return 1;
    add(e->z, -1.0, e->more, e->parts * e->wide);
    return 0;
}

/* z = E^-1 b by the factor itself, judged as linear/residual.py does; 0 where Python has to solve, and to judge. */
static int solved_here(const Field *e)
{
    double residual = 0.0, scale = 0.0;
    if (!e->factor || !*e->factor || refined(e)) return 0;

    for (int part = 0; part < e->parts; part++) {
        const double *b = e->b + part * e->wide;
        take_residual(e, part);
        residual += long_dot(e->left + part * e->wide, e->left + part * e->wide, e->wide);
        scale += long_dot(b, b, e->n);
    }
    residual = sqrt(scale > 0.0 ? residual / scale : residual);
    if (!(residual <= e->tolerance)) return 0;
    e->told[0] += 1.0;
    e->told[1] = fmax(e->told[1], residual);
    return 1;
}

/* z of the field's own forces times -scale, through its factor. */
static int field_alone(System *s, const Body *o, double scale, double t)
{
    const Field *e = o->field;
    for (int part = 0; part < e->parts; part++) {
        double *b = s->b + part * (s->nu + s->rows) + o->at_u + TWIST, *own = e->b + part * e->wide;
        for (long i = 0; i < e->n; i++) own[i] = -scale * e->force[part * e->n + i];

        /* what acts on the columns goes to the nodes: it is in balance with the rest, and what differs is small. Left to (2), whose S is
           stiff where columns do not move, each of both would leave its roundoff */
        add_columns(o, b, own);
        memset(b, 0, o->modes * sizeof(double));
        turn_nodes(e, own, e->n, 1);
    }
    if (solved_here(e)) return DONE;
    s->calls++;
    int told = s->python(FIELD, e->number, t);
    return told == OUTSIDE ? NEWTON : told ? FAILED : DONE;
}

/* y = A x of complex matrices and vectors, or real ones: all real parts come first, then all imaginary ones. */
static void apply(const Field *e, const double *A, int rows, int columns, const double *x, double *y)
{
    const double *imaginary = A + rows * columns, *other = x + columns;
    for (int i = 0; i < rows; i++) {
        y[i] = dot(A + columns * i, x, columns);
        if (e->parts == 1) continue;
        y[i] -= dot(imaginary + columns * i, other, columns);
        y[rows + i] = dot(A + columns * i, other, columns) + dot(imaginary + columns * i, x, columns);
    }
}

/* z += c times a column of E^-1 */
void answer_node(const Field *e, double c, const double *column)
{
    for (long i = 0; i < e->n; i++) e->z[i] += c * column[i];
}

/* The right-hand side of (2) into s->b by the numbers pz; its rows of the frame conditions hold what C^T dU has to be. */
void condense(System *s, const Body *o)
{
    const Field *e = o->field;
    const int k = e->solved, m = e->frames, wide = s->nu + s->rows;
    double *b = s->b + o->at_u + TWIST, *wanted = s->b + s->nu + e->row, open[2 * TWIST];
    for (int part = 0; part < e->parts; part++)
        for (int i = 0; i < m; i++) open[part * m + i] = e->pz[part * k + e->frame_slot[i]] - wanted[part * wide + i];

    /* h closes the frame conditions */
    apply(e, e->A, m, m, open, e->h);
    apply(e, e->W, k, m, e->h, e->rest);
    add(e->pz, -1.0, e->rest, e->parts * k);

    apply(e, e->S, k, k, e->pz, e->rest);
    for (int part = 0; part < e->parts; part++) {
        turn_nodes(e, e->rest + part * k, k, 0);
        add(b + part * wide, 1.0, e->rest + part * k, k);
        for (int i = 0; i < m; i++) wanted[part * wide + i] = 0.0;
    }
}

/* The same by the forces on the nodes times -scale, unless z is known; ``scale`` = 0: no forces. */
int field_load(System *s, const Body *o, double scale, double t)
{
    const Field *e = o->field;
    int verdict = DONE;
    if (scale == 0.0) memset(e->z, 0, e->parts * e->wide * sizeof(double));
    else if (!s->answered && (verdict = field_alone(s, o, scale, t))) return verdict;

    for (int part = 0; part < e->parts; part++) {
        double *z = e->z + part * e->wide, *pz = e->pz + part * e->solved;
        for (int i = 0; i < e->solved; i++) pz[i] = column(e, i, z);
        for (int r = 0; r < e->bends; r++) e->pull[r] = long_dot(e->held + e->n * r, z, e->n); /* as the factor's columns are bent */
        for (int i = 0; i < e->solved; i++) pz[i] -= dot(e->N + e->bends * i, e->pull, e->bends);
    }
    condense(s, o);
    return verdict;
}

/* What acts on the columns, and the multipliers of the frame conditions, from the numbers p in s->b. */
void field_answers(System *s, const Body *o)
{
    const Field *e = o->field;
    const int k = e->solved, m = e->frames, wide = s->nu + s->rows;
    const double *p = s->b + o->at_u + TWIST;
    double *lam = s->b + s->nu + e->row, reaction[2 * TWIST];
    for (int part = 0; part < e->parts; part++) {
        double *rest = e->rest + part * k;
        memcpy(rest, p + part * wide, k * sizeof(double));
        turn_nodes(e, rest, k, 1);
        for (int i = 0; i < k; i++) rest[i] = e->pz[part * k + i] - rest[i];
    }

    apply(e, e->S, k, k, e->rest, e->f);
    apply(e, e->G, m, k, e->f, reaction);
    for (int part = 0; part < e->parts; part++)
        for (int i = 0; i < m; i++) {
            lam[part * wide + i] = e->h[part * m + i] - reaction[part * m + i];
            e->f[part * k + e->frame_slot[i]] += lam[part * wide + i];
        }
}

/* dU and the multipliers of the frame conditions from the numbers p, in s->b; ``x``: like v. */
void field_increment(System *s, const Body *o, double *x)
{
    const Field *e = o->field;
    const int k = e->solved;
    field_answers(s, o);

    for (int part = 0; part < e->parts; part++) {
        double *dU = x + part * s->nv + o->at_v;
        memcpy(dU, e->z + part * e->wide, e->n * sizeof(double));
        for (int of = 0; of < e->parts; of++) /* parts of Y: their product with those of f */
            for (int i = 0; i < k; i++) {
                const double f = e->f[(part ^ of) * k + i], c = of && !part ? -f : f;
                if (c != 0.0) add(dU, -c, e->Y + e->n * (of * k + i), e->n);
            }
        turn_nodes(e, dU, e->n, 0);
    }
}

/* A solution with no right-hand side on the nodes comes next. */
void field_without_load(const Body *o)
{
    const Field *e = o->field;
    memset(e->z, 0, e->parts * e->wide * sizeof(double));
    memset(e->h, 0, e->parts * e->frames * sizeof(double));
    memset(e->pz, 0, e->parts * e->solved * sizeof(double));
}

/* The moments -sum M U x dU on the frame into s->b (world axes), for a solution with no other right-hand side; ``x``: like v. */
void field_sway(System *s, const Body *o, const double *R, const double *x)
{
    const Field *e = o->field;
    field_without_load(o);
    for (int part = 0; part < e->parts && e->sways; part++) {
        const double *dU = x + part * s->nv + o->at_v;
        double local[ROT] = {0.0}, one[ROT], turned[ROT];
        for (long i = 0; i < e->nodes; i++) {
            moment(e->MU + D * i, dU + D * i, one);
            add(local, -1.0, one, ROT);
        }

        to_world(R, local, turned);
        add(s->b + part * (s->nu + s->rows) + o->at_u + D, 1.0, turned, ROT);
    }
}
