/* Sums of coordinates, s = shift + sum_k c_k s_k: their rows are c_k times those of the terms, whose kernels alone are asked. An effort N
   on s has the tangent of any effort by the row of s, and the geometric stiffness of efforts c_k N on the terms. */

/* s and the rows of a sum from those of its terms, as their kernels left them; ``shares``: n for each term, of its rows, or NULL. */
void add_terms(const Batch *k, const double *shares)
{
    double *out = k->out;
    const double *c = k->factor;
    for (long i = 0; i < k->n; i++, out += k->outputs) {
        const int *to = k->into;
        memset(out, 0, k->outputs * sizeof(double));
        out[0] = k->shift[i];

        for (int j = 0; j < k->terms; j++, c++) {
            const Batch *term = k - k->terms + j;
            const double *from = term->out + i * term->outputs, share = shares ? shares[j * k->n + i] : 1.0;
            out[0] += *c * from[0];
            for (int e = 1; e < term->outputs; e++) out[*to++] += *c * share * from[e];
        }
    }
}

/* s and the rows of all items, where frames are placed. */
void values(const System *s, const Batch *k)
{
    for (const Batch *term = k - k->terms; term < k; term++) term->value(term->n, term->pair, s->frames, term->P, 0, term->out);
    if (k->terms) add_terms(k, NULL);
    else k->value(k->n, k->pair, s->frames, k->P, 0, k->out);
}

/* slope r r^T of items with frames on surfaces, r their rows on the rates of all bodies. */
static void mapped_squares(System *s, const Batch *k, const double *slope)
{
    for (long i = 0; i < k->n; i++) {
        const int *to = k->square_to + k->square_start[i], *on = k->row_on + k->row_start[i];
        double *r = s->big, y[TWIST];
        int total = 0;
        for (int side = 0; side < k->sides; side++) {
            const double *map;
            const int width = side_map(s, k->pair[k->sides * i + side], &map);
            row_of_side(k, i, side, y);
            if (width) through(map, width, y, r + total);
            total += width;
        }

        for (int c = 0; c < total; c++)
            for (int d = 0; d <= c; d++, to++) s->L[*to] += slope[i] * r[c] * r[d] * times_there(on, d, c);
    }
}
