/* Frames and maps of surfaces between both ends of a step of the energy-momentum scheme, (1) to (3) of
   schemes/onestep/conserving/discrete_gradient.py: A = (R_0 + R_1) / 2, with angular velocities A^-T w_b. */

#if DIM == 3
/* det A A^-T; det A */
static double cofactors(const double *A, double *C)
{
    for (int i = 0; i < 3; i++) moment(A + 3 * ((i + 1) % 3), A + 3 * ((i + 2) % 3), C + 3 * i);
    return dot(A, C, 3);
}

/* A^-T w */
static void spatial(const double *A, const double *w, double *out)
{
    double C[9], size = cofactors(A, C);
    times(C, w, out);
    for (int j = 0; j < 3; j++) out[j] /= size;
}

/* A^-1 m */
static void material(const double *A, const double *m, double *out)
{
    double C[9], size = cofactors(A, C);
    transposed(C, m, out);
    for (int j = 0; j < 3; j++) out[j] /= size;
}
#else
static void spatial(const double *A, const double *w, double *out) { (void)A, out[0] = w[0]; }
static void material(const double *A, const double *m, double *out) { (void)A, out[0] = m[0]; }
#endif

/* (3): what a rate of the port b_c turns by, before the factor of turn_of_ports(). */
static void turned_by_port(const double *A, int c, const double *rate, double *out)
{
#if DIM == 3
    double local[3], axis[3] = {0.0};
    axis[c] = 1.0;
    transposed(A, rate, local);
    moment(axis, local, out);
#else
    double axis[2] = {A[c], A[2 + c]};
    moment(axis, rate, out);
#endif
}

/* That factor, ROT x ROT, of a surface with the mean rotation A and mean ports b. */
static void turn_of_ports(const double *A, const double *b, double *Z)
{
#if DIM == 3
    double C[9], W[9], F[9], size = cofactors(A, C), trace = 0.0, whole;
    for (int i = 0; i < 9; i++) F[i] = b[3 + 3 * (i % 3) + i / 3] / size;
    for (int j = 0; j < 9; j++) W[j] = -(C[j / 3] * F[j % 3] + C[3 + j / 3] * F[3 + j % 3] + C[6 + j / 3] * F[6 + j % 3]);
    for (int i = 0; i < 3; i++) trace -= W[4 * i];
    for (int i = 0; i < 3; i++) W[4 * i] += trace;

    whole = size * cofactors(W, C);
    product_transposed(A, C, Z);
    for (int i = 0; i < 9; i++) Z[i] /= whole;
#else
    double stretch = 0.0;
    for (int c = 0; c < 2; c++) stretch += A[c] * b[2 + 2 * c] + A[2 + c] * b[3 + 2 * c];
    Z[0] = 1.0 / stretch;
#endif
}

/* The map of a surface of a field at rest by (3): its twist over the step from the rates of its ports. */
static void mean_surface(Surface *k, const double *A, int modes)
{
    const int width = TWIST + modes;
    double Z[ROT * ROT], lever[D];
    turn_of_ports(A, k->b, Z);
    times(A, k->p, lever);
    memset(k->map, 0, (size_t)TWIST * width * sizeof(double));

    for (int n = 0; n < modes; n++) {
        double sum[ROT] = {0.0}, one[ROT], rate[D], w[ROT], swing[D];
        for (int c = 0; c < D; c++) {
            for (int j = 0; j < D; j++) rate[j] = k->ports[(D * (1 + c) + j) * modes + n];
            turned_by_port(A, c, rate, one);
            add(sum, 1.0, one, ROT);
        }

        for (int j = 0; j < ROT; j++) w[j] = dot(Z + ROT * j, sum, ROT);
        spin(w, lever, swing);
        double *column = k->map + TWIST + n;
        for (int j = 0; j < D; j++) column[j * width] = k->ports[j * modes + n] + swing[j];
        for (int j = 0; j < ROT; j++) column[(D + j) * width] = w[j];
    }
}

/* Frames, velocities and maps of surfaces at the mean of both ends. */
static void place_mean(System *s, const Step *o)
{
    const double *map[2] = {o->maps[0], o->maps[1]};
    for (int i = 0; i < FRAME * (s->bodies + 1 + s->surfaces); i++) s->frames[i] = 0.5 * (o->frames[0][i] + o->frames[1][i]);
    for (int b = 0; b < s->bodies; b++) {
        const Body *k = s->body + b;
        double *x = s->frames + FRAME * b, *velocity = s->velocity + k->at_u;
        memcpy(x + SPEED, o->w + TWIST * b, D * sizeof(double));
        spatial(x + TURN, o->w + TWIST * b + D, x + SPIN);
        memcpy(velocity, x + SPEED, TWIST * sizeof(double));
        memcpy(velocity + TWIST, k->field ? k->field->rates : o->w + k->at_v, k->modes * sizeof(double));
    }

    for (int i = 0; i < s->surfaces; i++) {
        Surface *k = s->surface + i;
        const Body *body = s->body + k->body;
        const int width = TWIST + body->modes;
        double *velocity = s->velocity + s->nu + TWIST * i;
        for (int j = 0; j < TWIST * width; j++) k->map[j] = 0.5 * (*map[0]++ + *map[1]++);
        if (rests(body) && k->sort == MEAN) mean_surface(k, s->frames + FRAME * (s->bodies + 1 + i) + TURN, body->modes);
        for (int j = 0; j < TWIST; j++) velocity[j] = dot(k->map + j * width, s->velocity + body->at_u, width);
        memcpy(s->frames + FRAME * (s->bodies + 1 + i) + SPEED, velocity, TWIST * sizeof(double));
    }
}

