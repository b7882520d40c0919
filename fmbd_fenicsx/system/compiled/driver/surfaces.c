/* Surfaces of reduced and floating bodies: their frames, and their twists by the rates of the body, as mechanics/frames.py. */

/* The rates of the ports of a surface at the modes eta: ports - N (G eta), see mechanics/reduction/foreshortening.py. */
static void bend(Surface *k, const double *eta, int m)
{
    memcpy(k->now, k->ports, PORT * m * sizeof(double));
    for (int r = 0; r < k->bends; r++)
        for (int i = 0; i < m; i++) {
            double slope = dot(k->G + (r * m + i) * m, eta, m);
            for (int j = 0; j < PORT; j++) k->now[j * m + i] -= k->N[j * k->bends + r] * slope;
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
    for (int j = 0; j < D; j++) row[j] = l[j];
    for (int j = 0; j < ROT; j++) row[D + j] = turning[j] + w[j];

    /* in body axes: the mean's rate, and the rotation of the surface by its ports' rates */
    transposed(R, l, local);
    to_body(R, w, t);
    double across[ROT];
    moment(k->lever, local, across);
    for (int j = 0; j < ROT; j++) t[j] += across[j];
    for (int j = 0; j < ROT; j++) z[j] = dot(k->Z + ROT * j, t, ROT);
    const double *ports = k->bends ? k->now : k->ports;
    for (int j = 0; j < D; j++) add(row + TWIST, local[j], ports + m * j, m);
    for (int r = 0; r < k->bends; r++) {
        k->bend_map[k->bends * i + r] = 0.0;
        for (int j = 0; j < D; j++) k->bend_map[k->bends * i + r] += local[j] * k->N[k->bends * j + r];
    }
    for (int c = 0; c < D; c++) {
        spin(z, k->turn + D * c, slope);
        for (int j = 0; j < D; j++) {
            add(row + TWIST, slope[j], ports + m * (D * (1 + c) + j), m);
            for (int r = 0; r < k->bends; r++)
                k->bend_map[k->bends * i + r] += slope[j] * k->N[k->bends * (D * (1 + c) + j) + r];
        }
    }
}

int place_surface(System *s, int number, const double *q)
{
    Surface *k = s->surface + number;
    const Body *body = s->body + k->body;
    const double *frame = s->frames + FRAME * k->body, *R = frame + TURN, *eta = modes_of(body, q);
    double *x = s->frames + FRAME * (s->bodies + 1 + number), b[PORT], Rs[D * D], centre[D];
    int m = body->modes;

    if (k->bends) bend(k, eta, m);
    for (int j = 0; j < PORT; j++) {
        b[j] = k->reference[j] + dot(k->ports + m * j, eta, m);
        if (k->bends) b[j] = 0.5 * (b[j] + k->reference[j] + dot(k->now + m * j, eta, m)); /* the mean of both rates */
    }
    if (polar(b + D, k->turn, k->Z)) return LOOK;
    for (int j = 0; j < D; j++)
        for (int c = 0; c < D; c++) Rs[D * c + j] = k->turn[D * j + c];
    times(Rs, k->p, k->lever);
    for (int j = 0; j < D; j++) centre[j] = b[j] + k->lever[j];
    product(R, Rs, x + TURN);
    times(R, centre, k->arm);
    for (int j = 0; j < D; j++) x[j] = frame[j] + k->arm[j];
#if DIM == 2
    x[FRAME - 1] = frame[FRAME - 1] + atan2(Rs[2], Rs[0]);
#endif

    double *velocity = s->velocity + s->nu + TWIST * number;
    for (int i = 0; i < TWIST; i++) {
        surface_row(s, k, i);
        velocity[i] = dot(k->map + i * (TWIST + m), s->velocity + body->at_u, TWIST + m);
    }
    memcpy(x + SPEED, velocity, TWIST * sizeof(double));
    return DONE;
}
