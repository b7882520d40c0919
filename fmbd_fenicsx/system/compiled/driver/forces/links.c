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

/* w^T z of a row w as they stand in s->pull. */
static double pulled(const System *s, const double *w, const double *z)
{
    const long wide = s->nu + TWIST * s->surfaces + 1, size = s->nu + s->rows;
    double sum = 0.0;
    for (int part = 0; part < s->parts; part++) sum += dot(w + part * wide, z + part * size, s->nu);
    return sum;
}

/* (2) for the factor in the fronts, with weights by their parts; a complex w = w' + i w'' is two real rows, [w', -w''] and [w'', w']. */
static int link_efforts(System *s, const double *cd, const double *ck)
{
    const int parts = s->parts;
    const long wide = s->nu + TWIST * s->surfaces + 1, size = parts * (s->nu + s->rows), row = parts * wide;
    for (const Batch *k = s->batch; k < s->batch + s->batches; k++) {
        int answers = 0;
        for (int part = parts - 1; k->linked && part >= 0; part--) {
            s->cd = cd[part];
            s->ck = ck[part];
            answers |= control_link(s, k, s->push + s->links * wide, s->pull + (s->links * parts + part) * row);
        }
        s->links += answers;
    }

    for (const Batch *k = s->batch; k < s->batch + s->batches; k++)
        if (k->role == WHOLE) whole_links(s, k, cd, ck);
    const int count = s->links, m = parts * count;
    s->links = 0; /* until they are known */

    for (int k = 0; k < count; k++) {
        double *push = s->push + k * wide, *first = s->pull + k * parts * row, *second = first + row;
        fold(s, push);
        for (int part = 0; part < parts; part++) fold(s, first + part * row);
        for (long i = 0; parts > 1 && i < wide; i++) {
            first[wide + i] = -second[i];
            second[wide + i] = first[i];
        }

        for (int part = 0; part < parts; part++) {
            double *answer = s->answer + (k * parts + part) * size;
            memset(answer, 0, size * sizeof(double));
            memcpy(answer + part * (s->nu + s->rows), push, s->nu * sizeof(double));
            solve_fronts(s, answer);
        }
    }
    for (int i = 0; i < m; i++)
        for (int k = 0; k < m; k++) s->mutual[i * m + k] = (i == k) + pulled(s, s->pull + i * row, s->answer + k * size);
    if (!solve_dense(s->mutual, m, s->pull, row, row, MUTUAL)) s->links = m;
    return DONE;
}

/* b <- solution of the whole matrix, from that of the fronts. */
static void add_links(System *s, double *b)
{
    const long wide = s->nu + TWIST * s->surfaces + 1, size = s->parts * (s->nu + s->rows);
    for (int k = 0; k < s->links; k++) s->mutual[k] = pulled(s, s->pull + k * s->parts * wide, b);
    for (int k = 0; k < s->links; k++) add(b, -s->mutual[k], s->answer + k * size, size);
}
