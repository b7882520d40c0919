/* The step's matrix at the state evaluated last:

       [ M + cd C + ck K   G^T ]      K, C: of elastic bodies and of efforts, N r on a row r = ds/dV:
       [ G                  0  ]      (ck dN/ds + cd dN/ds') r r^T + ck N dr/dq                                        (1)

   The last term of (1) is the geometric stiffness of an effort; that of a reaction has lambda for N. */

/* ---- frames on surfaces: rows and blocks pass through the surface's map to the body's rates ---- */

/* Number of rates that move a frame, and the map from them to its twist (NULL: these are the twist). */
static int side_map(const System *s, int frame, const double **map)
{
    *map = 0;
    if (frame < s->bodies) return TWIST;
    if (frame == s->bodies) return 0;
    const Surface *k = s->surface + frame - s->bodies - 1;
    *map = k->map;
    return TWIST + s->body[k->body].modes;
}

/* y on a twist as a row on the rates */
static void through(const double *map, int width, const double *y, double *row)
{
    if (!map) {
        memcpy(row, y, TWIST * sizeof(double));
        return;
    }
    memset(row, 0, width * sizeof(double));
    for (int j = 0; j < TWIST; j++)
        if (y[j] != 0.0) add(row, y[j], map + (long)j * width, width);
}

/* The row of an item on the twists of both frames, 2 TWIST */
static void twist_row(const Batch *k, long i, double *y)
{
    const double *out = k->out + i * k->outputs;
    const int *where = k->where + 2 * TWIST * i;
    for (int j = 0; j < 2 * TWIST; j++) y[j] = where[j] ? out[where[j]] : 0.0;
}

static void mapped_rows(System *s, const Batch *k)
{
    for (long i = 0; i < k->n; i++) {
        const int *to = k->row_to + k->row_start[i], *on = k->row_on + k->row_start[i];
        double y[2 * TWIST], square = 0.0;
        twist_row(k, i, y);

        for (int side = 0; side < 2; side++) {
            const double *map;
            int width = side_map(s, k->pair[2 * i + side], &map);
            if (!width) continue;
            through(map, width, y + TWIST * side, s->big);
            for (int j = 0; j < width; j++, to++, on++) {
                double entry = k->factor[i] * s->big[j];
                s->L[*to] += entry;
                square += entry * entry / s->diagonal[*on];
            }
        }
        s->weight[k->row[i]] += square;
    }
}

static void mapped_square(System *s, const Batch *k, long i, const double *C)
{
    const double *map[2];
    int width[2], total = 0;
    for (int side = 0; side < 2; side++) total += width[side] = side_map(s, k->pair[2 * i + side], &map[side]);

    /* CM = C Map, by rows of C; then Map^T (C Map), column by column of Map: the columns of the result, symmetric */
    double *CM = s->big, *column = CM + 2 * TWIST * total;
    for (int j = 0; j < 2 * TWIST; j++) {
        double *row = CM + (long)j * total;
        for (int side = 0; side < 2; side++) {
            if (width[side]) through(map[side], width[side], C + 2 * TWIST * j + TWIST * side, row);
            row += width[side];
        }
    }
    const int *to = k->square_to + k->square_start[i];
    for (int c = 0; c < total; c++) {
        double y[2 * TWIST], *out = column;
        for (int j = 0; j < 2 * TWIST; j++) y[j] = CM[(long)j * total + c];
        for (int side = 0; side < 2; side++) {
            if (width[side]) through(map[side], width[side], y + TWIST * side, out);
            out += width[side];
        }
        for (int r = 0; r <= c; r++, to++) s->L[*to] += column[r];
    }
}

static void mapped_tangents(System *s, const Batch *k, const double *slope)
{
    for (long i = 0; i < k->n; i++) {
        double C[4 * TWIST * TWIST], y[2 * TWIST];
        twist_row(k, i, y);
        for (int a = 0; a < 2 * TWIST; a++)
            for (int b = 0; b < 2 * TWIST; b++) C[2 * TWIST * a + b] = slope ? slope[i] * y[a] * y[b] : 0.0;
        for (int e = 0; e < k->curved; e++) {
            int a = k->lower[2 * e], b = k->lower[2 * e + 1];
            double h = k->hessian[i * k->hessians + k->curve[e]];
            C[2 * TWIST * a + b] += h;
            if (a != b) C[2 * TWIST * b + a] += h;
        }
        mapped_square(s, k, i, C);
    }
}

/* ---- frames of bodies: entries go straight to their places ---- */

static void plain_rows(System *s, const Batch *k)
{
    const double *out = k->out;
    const int *dest = k->dest, *at = k->at;
    for (long i = 0; i < k->n; i++, out += k->outputs, dest += k->live, at += k->live) {
        double square = 0.0;
        for (int e = 0; e < k->live; e++) {
            double entry = k->factor[i] * out[k->entry[e]];
            s->L[dest[e]] += entry;
            square += entry * entry / s->diagonal[at[e]];
        }
        s->weight[k->row[i]] += square;
    }
}

static void plain_tangents(System *s, const Batch *k, const double *slope)
{
    const double *out = k->out, *hessian = k->hessian;
    const int *to = k->product_to;
    for (long i = 0; slope && i < k->n; i++, out += k->outputs)
        for (int e = 0; e < k->products; e++, to++) s->L[*to] += slope[i] * out[k->first[e]] * out[k->second[e]];

    to = k->curve_to;
    for (long i = 0; k->curved && i < k->n; i++, hessian += k->hessians)
        for (int e = 0; e < k->curved; e++, to++) s->L[*to] += hessian[k->curve[e]];
}

/* ---- all of it ---- */

/* The tangent of an effort or a reaction; ``geometric``: weight of its geometric stiffness. */
static int tangents(System *s, Batch *k, double cd, double ck, double geometric, const double *lam, double t)
{
    double *slope = 0;
    if (k->role == LAW) {
        s->calls++;
        if (s->python(SLOPES, k->number, t)) return FAILED;
    }
    if (k->role == LINEAR || k->role == LAW || k->role == FORMULA) {
        slope = k->slope;
        for (long i = 0; i < k->n; i++) slope[i] = ck * k->stiffness[i] + cd * k->damping[i];
    }

    int curved = k->curved && geometric != 0.0;
    for (long i = 0; i < k->n; i++) k->weight[i] = geometric * (k->role == ROW ? k->factor[i] * lam[k->row[i]] : k->effort[i]);
    if (curved) k->tangent(k->n, k->pair, s->frames, k->P, k->weight, k->hessian);
    else if (k->curved) memset(k->hessian, 0, k->n * k->hessians * sizeof(double));
    if (!slope && !curved) return DONE;
    if (k->mapped) mapped_tangents(s, k, slope);
    else plain_tangents(s, k, slope);
    return DONE;
}

/* ``reactions``: whether these have a geometric stiffness; verdict of the factorisation. */
static int assemble(System *s, const double *q, double cd, double ck, double geometric, const double *lam, int reactions, double t)
{
    int verdict;
    clear(s);
    s->cd = cd;
    s->ck = ck;
    for (int b = 0; b < s->bodies; b++) {
        const Body *o = s->body + b;
        const double *R = s->frames + FRAME * b + TURN;
        if (o->T) reduced_block(s, o, R, q + o->at_q, cd, ck);
        else rigid_block(s, o, R);
    }
    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->role == READ) continue;
        if (k->role == ROW && k->mapped) mapped_rows(s, k);
        else if (k->role == ROW) plain_rows(s, k);
        if (k->role == ROW && !reactions) continue;
        if ((verdict = tangents(s, k, cd, ck, geometric, lam, t))) return verdict;
    }
    for (Rod *k = s->rod; k < s->rod + s->rods; k++)
        if (rod_tangents(s, k, t, geometric)) return FAILED;
    if (s->laws) {
        s->calls++;
        if (s->python(SLOPES, -1, t)) return FAILED;
    }
    return factor(s);
}

/* The factor at the state evaluated last; without geometric stiffness where that makes the bodies' part indefinite (a large pull
   on a small inertia). */
static int prepare(System *s, const double *q, double cd, double ck, const double *lam, int reactions, double t)
{
    int verdict = assemble(s, q, cd, ck, ck, lam, reactions, t);
    return verdict == SINGULAR ? assemble(s, q, cd, ck, 0.0, lam, 0, t) : verdict;
}

/* Newton's increment: x (like v, body axes) and y from -scale times the residuals evaluated last and the open constraints. */
static void increment(System *s, double scale, double *x, double *y)
{
    double *b = s->b;
    for (int i = 0; i < s->nu; i++) b[i] = -scale * s->residual[i];
    for (int i = 0; i < s->rows; i++) b[s->nu + i] = -s->gap[i];
    back_solve(s, b);

    for (int k = 0; k < s->bodies; k++) {
        const Body *o = s->body + k;
        const double *u = b + o->at_u;
        memcpy(x + TWIST * k, u, D * sizeof(double));
        to_body(s->frames + FRAME * k + TURN, u + D, x + TWIST * k + D);
        memcpy(x + o->at_v, u + TWIST, o->modes * sizeof(double));
    }
    memcpy(y, b + s->nu, s->rows * sizeof(double));
}
