/* Frames on surfaces and bodies alike: rows and blocks pass through a frame's map to the rates of its body. */

/* Number of rates that move a frame, and the map from them to its twist (NULL: these are the twist). */
int side_map(const System *s, int frame, const double **map)
{
    *map = 0;
    if (frame < s->bodies) return TWIST;
    if (frame == s->bodies) return 0;
    const Surface *k = s->surface + frame - s->bodies - 1;
    *map = k->map;
    return TWIST + s->body[k->body].modes;
}

/* y on a twist as a row on the rates */
void through(const double *map, int width, const double *y, double *row)
{
    if (!map) {
        memcpy(row, y, TWIST * sizeof(double));
        return;
    }
    memset(row, 0, width * sizeof(double));
    for (int j = 0; j < TWIST; j++)
        if (y[j] != 0.0) add(row, y[j], map + (long)j * width, width);
}

/* The row of an item on the twists of both of its two frames, 2 TWIST */
void twist_row(const Batch *k, long i, double *y)
{
    const double *out = k->out + i * k->outputs;
    const int *where = k->where + 2 * TWIST * i;
    for (int j = 0; j < 2 * TWIST; j++) y[j] = where[j] ? out[where[j]] : 0.0;
}

/* The row of an item on the twist of one of its frames. */
static void row_of_side(const Batch *k, long i, int side, double *y)
{
    const double *out = k->out + 1 + i * k->outputs;
    memset(y, 0, TWIST * sizeof(double));
    for (int e = 0; e < k->outputs - 1; e++) {
        const int at = k->component[e] - TWIST * side;
        if (at >= 0 && at < TWIST) y[at] = out[e];
    }
}

static void mapped_rows(System *s, const Batch *k)
{
    for (long i = 0; i < k->n; i++) {
        const int *to = k->row_to + k->row_start[i], *on = k->row_on + k->row_start[i];
        double y[TWIST], square = 0.0;

        for (int side = 0; side < k->sides; side++) {
            const double *map;
            int width = side_map(s, k->pair[k->sides * i + side], &map);
            if (!width) continue;
            row_of_side(k, i, side, y);
            through(map, width, y, s->big);
            for (int j = 0; j < width; j++, to++, on++) {
                double entry = k->factor[i] * s->big[j];
                if (entry == 0.0) continue;
                s->L[*to] += entry;
                square += entry * entry / s->diagonal[*on];
            }
        }

        s->weight[k->row[i]] += square;
    }
}

/* A symmetric block on the twists of frames of bodies, from ``first`` up to ``end``. */
static void plain_square(System *s, const Batch *k, long i, int first, int end, const double *C)
{
    const int *to = k->square_to + k->square_start[i];
    for (int c = first; c < end; c++)
        for (int r = first; r <= c; r++, to++) s->L[*to] += C[2 * TWIST * c + r];
}

/* How often entry (r, c), r <= c, of a symmetric block counts where rates stand in several of its columns, as those of a body with
   two frames do: (r, c) and (c, r) are one place of the diagonal then. */
double times_there(const int *on, int r, int c)
{
    return r < c && on[r] == on[c] ? 2.0 : 1.0;
}

void mapped_square(System *s, const Batch *k, long i, const double *C)
{
    const double *map[2];
    int width[2], total = 0;
    for (int side = 0; side < 2; side++) total += width[side] = side_map(s, k->pair[2 * i + side], &map[side]);
    if (!map[0] && !map[1]) {
        plain_square(s, k, i, width[0] ? 0 : TWIST, width[1] ? 2 * TWIST : TWIST, C);
        return;
    }

    /* CM = C Map, by rows of C; then Map^T (C Map), column by column of Map: the columns of the result, symmetric */
    double *CM = s->big, *column = CM + 2 * TWIST * total;
    for (int j = 0; j < 2 * TWIST; j++) {
        double *row = CM + (long)j * total;
        for (int side = 0; side < 2; side++) {
            if (width[side]) through(map[side], width[side], C + 2 * TWIST * j + TWIST * side, row);
            row += width[side];
        }
    }

    const int *to = k->square_to + k->square_start[i], *on = k->row_on + k->row_start[i];
    for (int c = 0; c < total; c++) {
        double y[2 * TWIST], *out = column;
        for (int j = 0; j < 2 * TWIST; j++) y[j] = CM[(long)j * total + c];
        for (int side = 0; side < 2; side++) {
            if (width[side]) through(map[side], width[side], y + TWIST * side, out);
            out += width[side];
        }
        for (int r = 0; r <= c; r++, to++) s->L[*to] += column[r] * times_there(on, r, c);
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
