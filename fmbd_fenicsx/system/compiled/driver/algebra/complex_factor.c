/* L D L^T of a complex symmetric matrix by the fronts of factor.c, for stages of implicit schemes: weights 1, 1 / s and 1 / s^2 of a
   frequency s, whose stiffness times a number of unit size has a definite real part, so that no pivot vanishes. Real and imaginary
   parts stand apart, each as the real matrix has them. */

/* One pivot column: the columns behind it less its products, with the inverse a + i b of the pivot. */
static inline void eliminate_complex(double *F, double *E, int ld, int rows, int k, double a, double b)
{
    const lanes *real = (const lanes *)(F + (long)ld * k), *imaginary = (const lanes *)(E + (long)ld * k);
    for (int j = k + 1; j < rows; j++) {
        double x = F[(long)ld * k + j], y = E[(long)ld * k + j], c = x * a - y * b, d = x * b + y * a;
        if (c == 0.0 && d == 0.0) continue;
        lanes *to = (lanes *)(F + (long)ld * j), *beside = (lanes *)(E + (long)ld * j);
        for (int i = j / LANES; i < ld / LANES; i++) {
            to[i] -= real[i] * c - imaginary[i] * d;
            beside[i] -= real[i] * d + imaginary[i] * c;
        }
    }
}

/* SINGULAR when a pivot is small against what it is made of. */
static int factor_complex(System *s)
{
    double *other = s->inverse + s->nu + s->rows;
    s->factors++;
    soften(s);

    for (Front *f = s->front; f < s->front + s->fronts; f++) {
        double *F = s->L + f->start, *E = s->lossy + f->start;
        for (int k = 0; k < f->pivots; k++) {
            int u = f->unknown[k];
            double a = F[(long)(f->ld + 1) * k], b = E[(long)(f->ld + 1) * k], square = a * a + b * b;
            const double least = least_pivot(s, u);
            if (!(square > least * least)) return SINGULAR;
            s->inverse[u] = a / square;
            other[u] = -b / square;
            eliminate_complex(F, E, f->ld, f->rows, k, s->inverse[u], other[u]);
        }

        if (f->next < 0) continue;
        Front *g = s->front + f->next;
        for (int j = f->pivots; j < f->rows; j++) {
            long to = g->start + (long)g->ld * f->to[j - f->pivots];
            for (int i = j; i < f->rows; i++) {
                s->L[to + f->to[i - f->pivots]] += F[(long)f->ld * j + i];
                s->lossy[to + f->to[i - f->pivots]] += E[(long)f->ld * j + i];
            }
        }
    }
    return DONE;
}

/* b <- solution for the right-hand side b, real parts first. */
static void back_solve_complex(System *s, double *b)
{
    const int wide = s->nu + s->rows;
    double *x = s->local, *y = x + wide, *below = b + wide, *other = s->inverse + wide;

    for (Front *f = s->front; f < s->front + s->fronts; f++) {
        const double *F = s->L + f->start, *E = s->lossy + f->start;
        for (int k = 0; k < f->pivots; k++, F += f->ld, E += f->ld) {
            int u = f->unknown[k];
            double c = b[u] * s->inverse[u] - below[u] * other[u], d = b[u] * other[u] + below[u] * s->inverse[u];
            for (int i = k + 1; i < f->rows; i++) {
                b[f->unknown[i]] -= F[i] * c - E[i] * d;
                below[f->unknown[i]] -= F[i] * d + E[i] * c;
            }
        }
    }

    for (Front *f = s->front + s->fronts - 1; f >= s->front; f--) {
        for (int i = f->pivots; i < f->rows; i++) x[i] = b[f->unknown[i]], y[i] = below[f->unknown[i]];
        for (int k = f->pivots - 1; k >= 0; k--) {
            const double *F = s->L + f->start + (long)f->ld * k, *E = s->lossy + f->start + (long)f->ld * k;
            int u = f->unknown[k];
            double c = b[u], d = below[u];
            for (int i = k + 1; i < f->rows; i++) {
                c -= F[i] * x[i] - E[i] * y[i];
                d -= F[i] * y[i] + E[i] * x[i];
            }

            b[u] = x[k] = c * s->inverse[u] - d * other[u];
            below[u] = y[k] = c * other[u] + d * s->inverse[u];
        }
    }
}

/* b <- solution by the factor that is there, real or complex. */
static void solve_fronts(System *s, double *b)
{
    if (s->parts > 1) back_solve_complex(s, b);
    else back_solve(s, b);
}
