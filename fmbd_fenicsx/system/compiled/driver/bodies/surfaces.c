/* Surfaces of reduced and floating bodies: their frames, and their twists by the rates of the body, as mechanics/frames.py; and what ties see
   of bodies, as mechanics/joints/trace_rows.py: the integral of the places of a surface with one multiplier, x = m r + R (s + p), as
   if it were a point of the body's frame. */

/* Ports that a surface has. */
static int ports_of(const Surface *k) { return k->sort == INTEGRAL ? D : PORT; }

/* The rates of the ports of a surface at the modes eta: ports - N (G eta), see mechanics/elastic/foreshortening.py. */
static void bend(Surface *k, const double *eta, int m)
{
    double *slope = k->now + PORT * m;
    memcpy(k->now, k->ports, PORT * m * sizeof(double));
    for (int r = 0; r < k->bends; r++) {
        memset(slope, 0, m * sizeof(double));
        for (int j = 0; j < m; j++) add(slope, eta[j], k->G + (r * m + j) * m, m);
        for (int j = 0; j < PORT; j++)
            if (k->N[j * k->bends + r] != 0.0) add(k->now + j * m, -k->N[j * k->bends + r], slope, m);
    }
}

/* The row of the surface's velocity or angular velocity (component i, world axes) on the body's rates: equation (2) of frames.py. */
static void surface_row(const System *s, Surface *k, int i)
{
    const Body *body = s->body + k->body;
    const double *R = s->frames + FRAME * k->body + TURN;
    int m = body->modes;
    double *row = k->map + i * (TWIST + m), l[D] = {0.0}, w[ROT] = {0.0}, local[D], turning[ROT], t[ROT], z[ROT], slope[D];

    memset(row, 0, (TWIST + m) * sizeof(double));
    if (i < D) l[i] = 1.0;
    else w[i - D] = 1.0;
    moment(k->arm, l, turning);
    int moving = !rests(body);
    for (int j = 0; moving && j < D; j++) row[j] = k->measure * l[j];
    for (int j = 0; moving && j < ROT; j++) row[D + j] = turning[j] + w[j];

    /* in body axes: the mean's rate, and the rotation of the surface by its ports' rates */
    transposed(R, l, local);
    to_body(R, w, t);
    double across[ROT];
    moment(k->lever, local, across);
    for (int j = 0; j < ROT; j++) t[j] += across[j];
    for (int j = 0; j < ROT; j++) z[j] = dot(k->Z + ROT * j, t, ROT);
    const double *ports = k->bends ? k->now : k->ports;
    for (int j = 0; i < D && j < D; j++) add(row + TWIST, local[j], ports + m * j, m);
    if (k->sort == INTEGRAL) return;

    for (int r = 0; r < k->bends; r++) {
        k->bend_map[k->bends * i + r] = 0.0;
        for (int j = 0; j < D; j++) k->bend_map[k->bends * i + r] += local[j] * k->N[k->bends * j + r];
    }

    if (k->sort == SECTION) add(row + TWIST, t[0], ports + m * D, m);
    for (int c = 0; k->sort == MEAN && c < D; c++) {
        spin(z, k->turn + D * c, slope);
        for (int j = 0; j < D; j++) {
            add(row + TWIST, slope[j], ports + m * (D * (1 + c) + j), m);
            for (int r = 0; r < k->bends; r++)
                k->bend_map[k->bends * i + r] += slope[j] * k->N[k->bends * (D * (1 + c) + j) + r];
        }
    }
}

/* The columns of a rotation of the plane, behind each other. */
static void turned_by(double angle, double *columns)
{
    columns[0] = columns[D + 1] = cos(angle);
    columns[1] = sin(angle);
    columns[D] = -columns[1];
}

int place_surface(System *s, int number, const double *q)
{
    Surface *k = s->surface + number;
    const Body *body = s->body + k->body;
    const double *frame = s->frames + FRAME * k->body, *R = frame + TURN, *eta = modes_of(body, q);
    double *x = s->frames + FRAME * (s->bodies + 1 + number), *b = k->b, Rs[D * D], centre[D];
    int m = body->modes;

    if (k->bends) bend(k, eta, m);
    for (int j = 0; j < ports_of(k); j++) {
        b[j] = k->reference[j] + dot(k->ports + m * j, eta, m);
        if (k->bends) b[j] = 0.5 * (b[j] + k->reference[j] + dot(k->now + m * j, eta, m)); /* the mean of both rates */
    }

    if (k->sort == SECTION) turned_by(b[D], k->turn);
    else if (k->sort == MEAN && polar(b + D, k->turn, k->Z)) return LOOK; /* integrals keep turn = 1 */
    for (int j = 0; j < D; j++)
        for (int c = 0; c < D; c++) Rs[D * c + j] = k->turn[D * j + c];
    times(Rs, k->p, k->lever);
    for (int j = 0; j < D; j++) centre[j] = b[j] + k->lever[j];
    product(R, Rs, x + TURN);
    times(R, centre, k->arm);
    for (int j = 0; j < D; j++) x[j] = k->measure * frame[j] + k->arm[j];
#if DIM == 2
    x[FRAME - 1] = frame[FRAME - 1] + (k->sort == SECTION ? b[D] : atan2(Rs[2], Rs[0]));
#endif

    double *velocity = s->velocity + s->nu + TWIST * number;
    for (int i = 0; i < TWIST; i++) {
        surface_row(s, k, i);
        velocity[i] = dot(k->map + i * (TWIST + m), s->velocity + body->at_u, TWIST + m);
    }
    memcpy(x + SPEED, velocity, TWIST * sizeof(double));
    return DONE;
}

/* b_0' .. b_D' of a surface, and what the rates of the body alone add to b_0'' ..: -N (eta' G eta'). */
static void port_rates(const Surface *k, const Body *body, const double *rates, double *first, double *second)
{
    const Field *e = body->field;
    int m = body->modes;
    for (int j = 0; j < ports_of(k); j++) first[j] = dot((k->bends ? k->now : k->ports) + m * j, rates, m);
    for (int j = 0; j < ports_of(k); j++) second[j] = e && e->bias ? dot(k->ports + m * j, e->bias, m) : 0.0;
    for (int r = 0; r < k->bends; r++) {
        double shortened = 0.0;
        for (int i = 0; i < m; i++) shortened += rates[i] * dot(k->G + (r * m + i) * m, rates, m);
        for (int j = 0; j < PORT; j++) second[j] -= k->N[j * k->bends + r] * shortened;
    }
}

/* The surface's own turn in its body, speed w and rate of it, from Z^-1 w = sum_k (R_s e_k) x b_k' and its derivative. */
static void own_turn(const Surface *k, const double *first, const double *second, double *w, double *rate)
{
    double sum[ROT] = {0.0}, one[ROT], turned[D], Sd[D * D] = {0.0}, trace = 0.0;
    if (k->sort != MEAN) { /* the angle of a section; integrals turn with the frame */
        memset(w, 0, ROT * sizeof(double));
        memset(rate, 0, ROT * sizeof(double));
        if (k->sort == SECTION) w[0] = first[D], rate[0] = second[D];
        return;
    }

    for (int c = 0; c < D; c++) {
        moment(k->turn + D * c, first + D * (1 + c), one);
        add(sum, 1.0, one, ROT);
    }
    for (int i = 0; i < ROT; i++) w[i] = dot(k->Z + ROT * i, sum, ROT);

    memset(sum, 0, sizeof sum);
    for (int c = 0; c < D; c++) {
        spin(w, k->turn + D * c, turned);
        moment(turned, first + D * (1 + c), one);
        add(sum, 1.0, one, ROT);
        moment(k->turn + D * c, second + D * (1 + c), one);
        add(sum, 1.0, one, ROT);

        for (int i = 0; i < D; i++) {
            add(Sd + D * i, first[D * (1 + c) + i], k->turn + D * c, D);
            add(Sd + D * i, k->b[D * (1 + c) + i], turned, D);
        }
    }

    for (int i = 0; i < D; i++) trace += Sd[(D + 1) * i];
    for (int i = 0; i < ROT; i++) {
        sum[i] -= trace * w[i];
        for (int j = 0; DIM == 3 && j < ROT; j++) sum[i] += 0.5 * (Sd[D * i + j] + Sd[D * j + i]) * w[j];
    }
    for (int i = 0; i < ROT; i++) rate[i] = dot(k->Z + ROT * i, sum, ROT);
}

/* d/dt of the twist of a surface, world axes, at no accelerations of its body: as Moving.bias of frames.py. */
void surface_bias(System *s, int number)
{
    Surface *k = s->surface + number;
    const Body *body = s->body + k->body;
    const double *frame = s->frames + FRAME * k->body, *R = frame + TURN;
    double first[PORT], second[PORT], w[ROT], rate[ROT], spins[ROT], way[D], speed[D], x[D], y[D], accel[D];
    port_rates(k, body, s->velocity + body->at_u + TWIST, first, second);
    own_turn(k, first, second, w, rate);
    to_body(R, frame + SPIN, spins);
    transposed(R, k->arm, way);

    /* within the body: of the mean, and of the lever */
    spin(w, k->lever, x);
    for (int i = 0; i < D; i++) speed[i] = first[i] + x[i];
    spin(w, x, accel);
    spin(rate, k->lever, y);
    for (int i = 0; i < D; i++) accel[i] += y[i] + second[i];

    /* and with it */
    spin(spins, way, x);
    spin(spins, x, y);
    spin(spins, speed, x);
    for (int i = 0; i < D; i++) accel[i] += y[i] + 2.0 * x[i];
    times(R, accel, k->bias);
#if DIM == 3
    spin(spins, w, x);
    add(rate, 1.0, x, ROT);
#endif
    to_world(R, rate, k->bias + D);
}
