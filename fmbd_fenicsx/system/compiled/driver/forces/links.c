/* Efforts of laws in Python that answer to other coordinates than their own, or to the motion of markers, and what tangents of forces
   that Python gives as a whole lack of symmetry (whole.c). With a row l of what an effort
   pushes on and a row w of its slopes by all else that it reads, weighted as in matrix.c, the step's matrix is

       B = A + L W^T                                                                                                   (1)

   and A, which is symmetric and keeps its fronts, is solved with once for each effort (Sherman, Morrison and Woodbury):

       B^-1 b = z - P V z,   z = A^-1 b,   P = A^-1 L,   V = (1 + W^T P)^-1 W^T                                        (2) */

static const double MUTUAL = 1e-13; /* smallest pivot of 1 + W^T P, over its largest entry; V takes the place of W */

/* What stands in a row on twists of surfaces, on the rates of their bodies. */
static void fold(const System *s, double *row)
{
    for (int i = 0; i < s->surfaces; i++) {
        const Surface *k = s->surface + i;
        const int width = TWIST + s->body[k->body].modes;
        const double *on = row + s->nu + TWIST * i;
        for (int j = 0; j < TWIST; j++)
            if (on[j] != 0.0) add(row + s->body[k->body].at_u, on[j], k->map + j * width, width);
    }
}

/* Whether forces that Python gives as a whole lack symmetry in the matrix assembled last. */
static int lacks_symmetry(System *s)
{
    for (const Batch *k = s->batch; k < s->batch + s->batches; k++)
        if (k->role == WHOLE) whole_links(s, k);
    const int found = s->links;
    s->links = 0;
    return found > 0;
}

/* (2) for the factor in the fronts. */
static int link_efforts(System *s)
{
    const long wide = s->nu + TWIST * s->surfaces + 1, size = s->nu + s->rows;
    for (const Batch *k = s->batch; k < s->batch + s->batches; k++)
        if (k->linked) s->links += control_link(s, k, s->push + s->links * wide, s->pull + s->links * wide);
    for (const Batch *k = s->batch; k < s->batch + s->batches; k++)
        if (k->role == WHOLE) whole_links(s, k);
    int m = s->links;
    s->links = 0; /* until they are known */
    for (int k = 0; k < m; k++) {
        double *push = s->push + k * wide, *answer = s->answer + k * size;
        fold(s, push);
        fold(s, s->pull + k * wide);
        memcpy(answer, push, s->nu * sizeof(double));
        memset(answer + s->nu, 0, s->rows * sizeof(double));
        back_solve(s, answer);
    }
    for (int i = 0; i < m; i++)
        for (int k = 0; k < m; k++) s->mutual[i * m + k] = (i == k) + dot(s->pull + i * wide, s->answer + k * size, s->nu);
    if (!solve_dense(s->mutual, m, s->pull, wide, s->nu, MUTUAL)) s->links = m;
    return DONE;
}

/* b <- solution of the whole matrix, from that of the fronts. */
static void add_links(System *s, double *b)
{
    const long wide = s->nu + TWIST * s->surfaces + 1, size = s->nu + s->rows;
    for (int k = 0; k < s->links; k++) s->mutual[k] = dot(s->pull + k * wide, b, s->nu);
    for (int k = 0; k < s->links; k++) add(b, -s->mutual[k], s->answer + k * size, size);
}
