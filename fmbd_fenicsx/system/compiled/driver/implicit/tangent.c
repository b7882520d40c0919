/* The tangent of the equations of an implicit step by patterns, and the matrices of its stage systems: see (1) of
   system/compiled/states/stage_patterns.py, whose symbols these are. Coordinates that no row knows together are moved together, so
   that the number of evaluations does not grow with the length of chains. */

static const double TURNED = 1e-6; /* rad and m, of differences of rates */
static const double CENTRAL = 0x1.965fea53d6e3dp-18, FORWARD = 0x1p-26; /* cube and square root of the roundoff: shares of sizes */

/* Pairs of entries of A and B, and to which entry of A B they add their product. */
typedef struct {
    long pairs, *a, *b, *to;
} Product;

/* Where data have their entries. */
typedef struct {
    int n, m, size, levels, first, colours, moves; /* moves: of coordinates, that are unknowns of factors on each level behind the first */
    Ties *ties;                       /* of the unknowns behind the multipliers */
    double pulls[2];                  /* of the form, see Form */
    long shares, acting, *of_bodies;  /* of balances of bodies with many others on them, one by each of these: whose */
    long *acts;                       /* batch, item and share of what acts between them */
    long low, crossings, columns;     /* entries of the lower rows, of their products with U, of K */
    int *G_start, *G_on, *M_start, *colour; /* G, M by rows; by which number each coordinate is moved */
    int *R_start, *R_on;              /* rows of ties, R */
    long *across, *across_ties;       /* entries of G in the order of G^T, and those of R */
    long *coloured_start, *coloured;  /* entries of the lower rows by the number that moves them */
    long *row, *column;               /* of entries of the lower rows; a row behind all of these is a number of a share */
    long masses, *of_masses, *of_level, *of_ties;
    long *taken;                      /* entries of K among those of its blocks side by side */
    long moving, along, *on_moves, *of_moves; /* entries of the lower rows on coordinates with such moves, and of U there */
    Product normal, turned, crossed;
    long J, M, G, U, by_q, by_v, by_a, slopes, R; /* where each matrix begins among the data of a tangent */
    const double *frozen;             /* data of U where steps keep it, else NULL */
} Patterns;

static void multiply(const Product *p, double factor, const double *a, const double *b, double *c)
{
    for (long i = 0; i < p->pairs; i++) c[p->to[i]] += factor * a[p->a[i]] * b[p->b[i]];
}

/* Rows of the constraints of so many levels from the ``first`` one on, 0 to 2: g, G v + g_t and, with the numbers of ``pulls``,

     G a + gamma + pulls[0] (G v + g_t) + pulls[1] g */
typedef struct {
    int n, m, levels, first;
    const double *pulls;
} Form;

/* Those of accelerations where drift() has left the others. */
static void acceleration_rows(System *s, const Form *o, const double *a, double *rows)
{
    double *partial = s->work, *second = partial + s->rows;
    for (int i = 0; i < o->m; i++) rows[i] = o->pulls[0] * s->slip[i] + o->pulls[1] * s->gap[i];
    derivatives_in_time(s, partial, second);
    add(rows, 1.0, second, o->m);
    turn_velocity(s, a);
    slips(s, 1); /* rows as they are now */
    slips(s, 0);
    add(rows, 1.0, s->slip, o->m);
}

/* All of them behind n numbers, and what springs with given efforts leave, where a state with these accelerations was evaluated. */
static void level_rows(System *s, const Form *o, const double *a, double *low)
{
    if (s->ties) tie_rows(s, 0, low + o->n + o->levels * o->m);
    drift(s);
    for (int k = 0; k < o->levels; k++) {
        double *rows = low + o->n + k * o->m;
        const int level = o->first + k;
        if (level < 2) memcpy(rows, level ? s->slip : s->gap, o->m * sizeof(double));
        else acceleration_rows(s, o, a, rows);
    }
}

/* d rate(xi, v) / d xi, body by body, and T with v = T rate(xi, v); either may be NULL. */
static int turning(const System *s, const double *xi, const double *v, double *J, double *T)
{
    for (int b = 0; b < s->bodies; b++, xi += TWIST, v += TWIST) {
        double rates[TWIST * TWIST] = {0.0}, one[TWIST * TWIST] = {0.0}, both[2][TWIST], moved[TWIST];
        for (int c = 0; J && c < TWIST; c++) {
            for (int side = 0; side < 2; side++) {
                memcpy(moved, xi, sizeof moved);
                memcpy(both[side], v, sizeof moved);
                moved[c] += side ? -TURNED : TURNED;
                rate_of(moved, both[side]);
            }
            for (int r = 0; r < TWIST; r++) J[r * TWIST + c] = (both[0][r] - both[1][r]) / (2.0 * TURNED);
        }

        for (int c = 0; T && c < TWIST; c++) {
            memset(moved, 0, sizeof moved);
            moved[c] = one[c * TWIST + c] = 1.0;
            rate_of(xi, moved);
            for (int r = 0; r < TWIST; r++) rates[r * TWIST + c] = moved[r];
        }
        if (T && solve_dense(rates, TWIST, one, TWIST, TWIST, 0.0)) return SINGULAR;
        if (J) J += TWIST * TWIST;
        if (T) memcpy(T, one, sizeof one), T += TWIST * TWIST;
    }

    for (int i = TWIST * s->bodies; i < s->nv; i++) {
        if (J) *J++ = 0.0;
        if (T) *T++ = 1.0;
    }
    return DONE;
}

EXPORT int driver_stage_turning(System *s, const double *xi, const double *v, double *J, double *T)
{
    return turning(s, xi, v, J, T);
}

/* G by its pattern, where frames are placed. ``row``: room, nv. */
static void pattern_rows(System *s, const Patterns *o, double *row, double *G)
{
    memset(G, 0, o->G_start[o->m] * sizeof(double));
    memset(row, 0, s->nv * sizeof(double));

    for (Batch *k = s->batch; k < s->batch + s->batches; k++) {
        if (k->role != ROW) continue;
        k->value(k->n, k->pair, s->frames, k->P, 0, k->out);
        for (long i = 0; i < k->n; i++) {
            int number = k->row[i];
            item_row(s, k, i, 1.0, row);

            for (int p = o->G_start[number]; p < o->G_start[number + 1]; p++) {
                G[p] += row[o->G_on[p]];
                row[o->G_on[p]] = 0.0;
            }
        }
    }
}

/* U = W G^T by its pattern. */
static void normal_directions(const Patterns *o, const double *W, const double *G, double *U)
{
    memset(U, 0, (o->by_q - o->U) * sizeof(double));
    for (long i = 0; i < o->normal.pairs; i++) U[o->normal.to[i]] += W[o->normal.a[i]] * G[o->across[o->normal.b[i]]];
}

/* What acts between bodies with many others on them and each of these, on the former, where a state was evaluated: TWIST numbers
   for each. */
static void note_shares(const System *s, const Patterns *o, const double *lam, double *shares)
{
    memset(shares, 0, TWIST * o->shares * sizeof(double));
    for (const long *x = o->acts; x < o->acts + 3 * o->acting; x += 3) {
        const Batch *k = s->batch + x[0];
        const double *out = k->out + x[1] * k->outputs, force = k->role == ROW ? k->factor[x[1]] * lam[k->row[x[1]]] : k->effort[x[1]];
        const int *at = k->at + x[1] * k->live, first = s->body[o->of_bodies[x[2]]].at_u;
        for (int e = 0; e < k->live; e++)
            if (first <= at[e] && at[e] < first + TWIST) shares[TWIST * x[2] + at[e] - first] += force * out[k->entry[e]];
    }

#if DIM == 3 /* moments in axes of the body */
    for (long i = 0; i < o->shares; i++) {
        double *moment = shares + TWIST * i + D, world[3];
        memcpy(world, moment, sizeof world);
        to_body(s->frames + FRAME * o->of_bodies[i] + TURN, world, moment);
    }
#endif
}

/* The balance, the constraints of all levels and ties at a state, and behind them the shares of balances. */
static int lower_rows(System *s, const Patterns *o, double t, const double *q, const double *v, const double *a, const double *lam,
                      double *low)
{
    give(s, o->ties, lam + o->levels * o->m);
    int verdict = evaluate(s, q, v, a, lam, t);
    if (verdict == LOOK) verdict = DONE; /* bodies that NumPy warns of are evaluated like others */
    const Form form = {o->n, o->m, o->levels, o->first, o->pulls};
    if (!verdict) {
        like_v(s, s->residual, low);
        note_shares(s, o, lam, low + o->size);
        level_rows(s, &form, a, low);
    }
    give(s, NULL, NULL);
    return verdict;
}

/* By how much coordinates and velocities are moved: as difference_steps() there. */
static void difference_steps(const System *s, double length, const double *q, const double *v, const double *a, double *hq, double *hv)
{
    double slow = 0.1 * sqrt(largest_of(s->units, a, s->nv) * length), fastest[2] = {0.0, 0.0}; /* m/s; of places and of turns */
    if (slow == 0.0) slow = 1e-2;
    for (int b = 0; b < s->bodies; b++)
        for (int i = 0; i < TWIST; i++) fastest[i >= D] = fmax(fastest[i >= D], fabs(v[TWIST * b + i]));
    position_sizes(s, length, q, hq);
    for (int i = 0; i < s->nv; i++) hq[i] *= CENTRAL;
    for (int b = 0; b < s->bodies; b++) {
        const Body *o = s->body + b;
        for (int i = 0; i < TWIST; i++) hv[TWIST * b + i] = FORWARD * fmax(fastest[i >= D], slow / (i < D ? 1.0 : length));
        if (o->modes) own_sizes(o->modes, s->units + o->at_v, v + o->at_v, 1e-2, slow, FORWARD, hv + o->at_v);
    }
}

/* The lower half of M of a part that Python tells, and of nothing else. */
static int told_masses(System *s, const Body *o, double t)
{
    const double cd = s->cd, ck = s->ck;
    s->cd = s->ck = 0.0;
    s->calls++;
    const int verdict = s->python(PART_TANGENTS, o->told->number, t);
    s->cd = cd;
    s->ck = ck;
    return verdict;
}

/* M of bodies with modes by its pattern, and its inverse W; frames are placed. ``room``: twice the square of a body's coordinates. Rigid
   bodies keep theirs. */
static int modal_masses(System *s, const Patterns *o, double t, const double *q, double *M, double *W, double *room)
{
    for (int b = 0; b < s->bodies; b++) {
        const Body *body = s->body + b;
        const int n = TWIST + body->modes;
        const double *R = s->frames + FRAME * b + TURN;
        double *A = room, *B = A + n * n;
        const double *block = body->told ? body->told->block : body->block;
        if (!body->T && !body->told) continue;

        if (!body->told) reduced_block(s, body, R, q + body->at_q, 0.0, 0.0);
        else if (told_masses(s, body, t)) return FAILED;
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++) A[n * i + j] = block[i < j ? n * j + i : n * i + j];
#if DIM == 3 /* turns about axes of the body */
        for (int side = 0; side < 2; side++)
            for (int i = 0; i < n; i++) {
                int at = side ? n * i + D : n * D + i, step = side ? 1 : n;
                double world[3] = {A[at], A[at + step], A[at + 2 * step]}, local[3];
                to_body(R, world, local);
                for (int j = 0; j < 3; j++) A[at + j * step] = local[j];
            }
#endif

        for (int i = 0; body->inertia && i < D; i++) A[(n + 1) * i] += body->mass;
        for (int i = 0; body->inertia && i < ROT; i++)
            for (int j = 0; j < ROT; j++) A[n * (D + i) + D + j] += body->inertia[ROT * i + j];
        memset(B, 0, (size_t)n * n * sizeof(double));

        for (int i = 0; i < n; i++) {
            B[(n + 1) * i] = 1.0;
            memcpy(M + o->M_start[i < TWIST ? TWIST * b + i : body->at_v + i - TWIST], A + n * i, n * sizeof(double));
        }

        if (solve_dense(A, n, B, n, n, 0.0)) return SINGULAR;
        for (int i = 0; i < n; i++)
            memcpy(W + o->M_start[i < TWIST ? TWIST * b + i : body->at_v + i - TWIST], B + n * i, n * sizeof(double));
    }
    return DONE;
}

/* Slopes of formulas where the tangent is taken, dN/ds and dN/ds' of each. */
static void note_slopes(const System *s, double *noted)
{
    for (const Batch *k = s->batch; k < s->batch + s->batches; k++)
        for (long i = 0; k->role == FORMULA && i < k->n; i++) {
            *noted++ = k->stiffness[i];
            *noted++ = k->damping[i];
        }
}

/* Derivatives of the lower rows: central differences by coordinates, moved by hq, forward ones by velocities, moved by hv; laws
   tell their slopes, and count as their tangents then: a difference may lead over a corner, or through all of a steep one.
   ``room``: 2 n + nq + 3 sizes of the lower rows and of the shares. */
static int slopes(System *s, const Patterns *o, double t, const double *q, const double *v, const double *a, const double *lam,
                  const double *hq, const double *hv, double *by_q, double *by_v, double *noted, double *room)
{
    double *moved = room, *faster = moved + o->n, *there = faster + o->n, *rest = there + s->nq;
    double *ahead = rest + o->size + TWIST * o->shares, *back = ahead + o->size + TWIST * o->shares;
    int verdict = lower_rows(s, o, t, q, v, a, lam, rest);
    for (Batch *k = s->batch; !verdict && k < s->batch + s->batches; k++) verdict = take_slopes(s, k, t);
    for (const Body *b = s->body; !verdict && b < s->body + s->bodies; b++)
        if (b->told && b->told->rests) verdict = take_part_slopes(s, b, q, v, t);
    note_slopes(s, noted);
    s->straight = 1;

    for (int c = 0; !verdict && c < o->colours; c++) {
        for (int side = 1; side >= -1; side -= 2) {
            for (int i = 0; i < o->n; i++) moved[i] = o->colour[i] == c ? side * hq[i] : 0.0;
            configuration(s, q, moved, there);
            if ((verdict = lower_rows(s, o, t, there, v, a, lam, side > 0 ? ahead : back))) return verdict;
        }

        for (long i = o->coloured_start[c]; i < o->coloured_start[c + 1]; i++) {
            const long p = o->coloured[i], row = o->row[p];
            by_q[p] = (ahead[row] - back[row]) / (2.0 * hq[o->column[p]]);
        }

        for (int i = 0; i < o->n; i++) faster[i] = o->colour[i] == c ? v[i] + hv[i] : v[i];
        if ((verdict = lower_rows(s, o, t, q, faster, a, lam, ahead))) return verdict;
        for (long i = o->coloured_start[c]; i < o->coloured_start[c + 1]; i++) {
            const long p = o->coloured[i], row = o->row[p], at = o->column[p];
            by_v[p] = (ahead[row] - rest[row]) / (faster[at] - v[at]);
        }
    }
    return verdict;
}

/* The tangent at a state of a model of this length. ``M``, ``W``: data of the masses and of their inverse, where those of rigid bodies
   are; ``room``: 2 n more than above, and that of the masses. */
EXPORT int driver_stage_tangent(System *s, const Patterns *o, double length, double t, const double *q, const double *v, const double *a,
                                const double *lam, double *M, double *W, double *room, double *data)
{
    double *hq = room, *hv = hq + o->n, *rest = hv + o->n;
    double *G = data + o->G, *U = data + o->U, *by_q = data + o->by_q, *by_v = data + o->by_v, *by_a = data + o->by_a, last = NAN;
    int verdict = sample(s, t, &last);
    difference_steps(s, length, q, v, a, hq, hv);
    if (!verdict) verdict = slopes(s, o, t, q, v, a, lam, hq, hv, by_q, by_v, data + o->slopes, rest);
    s->straight = 0;
    if (verdict) return verdict;
    if ((verdict = place(s, q, v)) || (verdict = modal_masses(s, o, t, q, M, W, rest))) return verdict;
    memset(room, 0, s->nv * sizeof(double));
    memset(room + s->nv, 0, s->nv * sizeof(double));
    turning(s, room, v, data + o->J, NULL);

    /* known exactly: M, and G on the level of each row */
    pattern_rows(s, o, room, G);
    memcpy(data + o->M, M, o->masses * sizeof(double));
    memset(by_a, 0, o->low * sizeof(double));
    for (long i = 0; i < o->masses; i++) by_a[o->of_masses[i]] = M[i];
    if (o->ties) tie_slopes(s, o->ties, o->R_start, o->R_on, o->of_ties, room, data + o->R, by_q, by_v);

    long count = o->G_start[o->m];
    for (int k = 0; k < o->levels; k++)
        for (long i = 0; i < count; i++) {
            const long p = o->of_level[k * count + i], level = o->first + k;
            if (level == 2) by_a[p] = G[i];
            else by_v[p] = level ? G[i] : 0.0;
            if (level == 0) by_q[p] = G[i];
        }

    if (o->frozen) memcpy(U, o->frozen, (o->by_q - o->U) * sizeof(double));
    else normal_directions(o, W, G, U);
    return DONE;
}

/* K0, K1 and K2 of (1). ``room``: blocks of K side by side, zero behind all that is written here. */
static void powers(const Patterns *o, const double *data, double *room, double *const K[3])
{
    const double *by[3] = {data + o->by_q, data + o->by_v, data + o->by_a}, *G = data + o->G;
    const int ties = o->ties ? o->ties->count : 0;
    const long pulling = ties ? o->R_start[ties] : 0, count = o->levels ? o->G_start[o->m] : 0;

    for (int k = 0; k < 3; k++) {
        for (long i = 0; i < pulling; i++) room[i] = k ? 0.0 : data[o->R + o->across_ties[i]];
        for (long i = pulling; i < pulling + ties; i++) room[i] = k ? 0.0 : -1.0;

        double *low = room + pulling + ties, *across = low + o->low, *crossed = across + count;
        memcpy(low, by[k], o->low * sizeof(double));
        if (DIM == 3 && k < 2) multiply(&o->turned, -1.0, by[k + 1], data + o->J, low);
        for (long i = 0; i < count; i++) across[i] = k ? 0.0 : G[o->across[i]];
        for (int level = 1; level < o->levels; level++) {
            const double *by_move = k + level < 3 ? by[k + level] : NULL;
            double *moving = crossed + o->crossings, *own = moving + o->moving, *along = own + o->moves;
            memset(crossed, 0, o->crossings * sizeof(double));
            if (by_move) multiply(&o->crossed, 1.0, by_move, data + o->U, crossed);
            for (long i = 0; i < o->moving; i++) moving[i] = by_move ? by_move[o->on_moves[i]] : 0.0;
            for (int i = 0; i < o->moves; i++) own[i] = !k;
            for (long i = 0; i < o->along; i++) along[i] = k ? 0.0 : -data[o->U + o->of_moves[i]];
            crossed = along + o->along;
        }
        for (long i = 0; i < o->columns; i++) K[k][i] = room[o->taken[i]];
    }
}
