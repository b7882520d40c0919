/* Inertia, elastic forces and weight of bodies, their energies, and their blocks of the step's matrix.

   Rigid: m (r'' - g), J w' + w x J w. Moments are returned in world axes. Angular velocities and accelerations come in body axes. */

static void rigid_force(const Body *o, const double *R, const double *w, const double *a, const double *gravity, double *f)
{
    double local[ROT];
    for (int i = 0; i < D; i++) f[i] = o->mass * (a[i] - gravity[i]);
    for (int i = 0; i < ROT; i++) local[i] = dot(o->inertia + ROT * i, a + D, ROT);
#if DIM == 3
    double Jw[3], gyro[3];
    for (int i = 0; i < 3; i++) Jw[i] = dot(o->inertia + 3 * i, w, 3);
    moment(w, Jw, gyro);
    for (int i = 0; i < 3; i++) local[i] += gyro[i];
#else
    (void)w;
#endif
    to_world(R, local, f + D);
}

/* The lower half of a body's block of M into the fronts; world axes. */
static void rigid_block(System *s, const Body *o, const double *R)
{
    const int *dest = o->dest;
    double *diagonal = s->diagonal + o->at_u;
    for (int i = 0; i < D; i++) {
        s->L[dest[i]] += o->mass;
        diagonal[i] = o->mass;
    }

    dest += D;
#if DIM == 3
    double T[9], J[9];
    for (int c = 0; c < 3; c++) times(R, o->inertia + 3 * c, T + 3 * c); /* J R^T by rows, J symmetric */
    for (int a = 0; a < 3; a++)
        for (int c = 0; c <= a; c++) J[3 * a + c] = T[a] * R[3 * c] + T[3 + a] * R[3 * c + 1] + T[6 + a] * R[3 * c + 2];

    for (int a = 0; a < 3; a++) {
        for (int c = 0; c <= a; c++) s->L[*dest++] += J[3 * a + c];
        diagonal[3 + a] = J[4 * a];
    }
#else
    (void)R;
    s->L[*dest] += o->inertia[0];
    diagonal[D] = o->inertia[0];
#endif
}

/* Kinetic, elastic and potential energy of weight of one body, added to out. */
static void body_energies(const Body *o, const double *R, const double *q, const double *v, const double *pose, const double *twist,
                          const double *gravity, double *out)
{
    if (!o->T && !o->inertia) return;
    if (!o->T) {
        double speed = dot(twist, twist, D), turning = 0.0;
        for (int i = 0; i < ROT; i++) turning += twist[D + i] * dot(o->inertia + ROT * i, twist + D, ROT);
        out[0] += 0.5 * (o->mass * speed + turning);
        out[2] -= o->mass * dot(pose, gravity, D);
        return;
    }
    reduced_energies(o, R, q, v, pose, twist, gravity, out);
}
