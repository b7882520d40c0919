/* How closed contacts open under forces on each other, W = L A^-1 L^T at the frames evaluated last, whose matrix is factored: the blocks
   of a contact on itself, which every problem needs, and the others of a group, where its last forces do not serve. */

/* A force along the row k of the closed contacts, added to the right-hand side in world axes. */
static void push_row(System *s, const Contacts *c, int k, double force)
{
    const int *on = c->on + 2 * c->closed[k / c->components];
    const double *row = c->rows + 2 * c->wide * k;
    for (int side = 0; side < 2 && force != 0.0; side++, row += c->wide) {
        if (on[side] < 0) continue;
        const Body *body = s->body + on[side];
        double turning[ROT], *to = s->b + body->at_u;
        to_world(s->frames + FRAME * on[side] + TURN, row + D, turning);
        add(to, force, row, D);
        add(to + D, force, turning, ROT);
        add(to + TWIST, force, row + TWIST, body->modes);
    }
}

/* How the row k moves along what a force on the row l does: that is known on its trees only. */
static double answer_of(const System *s, const Contacts *c, int k, int l)
{
    const int *on = c->on + 2 * c->closed[k / c->components];
    const double *row = c->rows + 2 * c->wide * k, *v = c->Y + (long)s->nv * l;
    int trees[2];
    double sum = 0.0;
    trees_of(c, c->closed[l / c->components], trees);
    for (int side = 0; side < 2; side++, row += c->wide) {
        if (on[side] < 0) continue;

        const int tree = c->tree_of[on[side]];
        const Body *body = s->body + on[side];
        if (tree != trees[0] && tree != trees[1]) continue;
        sum += dot(row, v + TWIST * on[side], TWIST);
        if (body->modes) sum += dot(row + TWIST, v + body->at_v, body->modes);
    }
    return sum;
}

/* What forces on the rows of all closed contacts do, and the blocks of each on itself. */
static void own_compliance(System *s, Contacts *c, int m)
{
    const int d = c->components, n = m * d;
    memset(s->b, 0, (s->nu + s->rows) * sizeof(double));
    memset(c->known_of, 0, c->graph.groups * sizeof(int));
    for (int k = 0; k < n; k++) {
        int trees[2];
        trees_of(c, c->closed[k / d], trees);
        push_row(s, c, k, 1.0);
        for (int side = 0; side < 2; side++)
            if (trees[side] >= 0) tree_solution(s, c->tree + trees[side], c->Y + (long)s->nv * k);
    }

    for (int i = 0; i < m; i++) {
        double *own = c->all.own + i * d * d;
        for (int a = 0; a < d; a++)
            for (int b = 0; b <= a; b++)
                own[a * d + b] = own[b * d + a] = 0.5 * (answer_of(s, c, i * d + a, i * d + b) + answer_of(s, c, i * d + b, i * d + a));
    }
}

/* The blocks of a group on each other. */
static void know_group(Contacts *c, int g)
{
    if (c->known_of[g]) return; /* as of problems of their own, which have no graph */
    const int d = c->components, from = c->graph.group[g], to = c->graph.group[g + 1];
    c->known_of[g] = 1;
    for (int i = from; i < to; i++)
        for (int e = c->all.first[i]; e < c->all.first[i + 1]; e++)
            for (int a = 0; a < d; a++)
                for (int b = 0; b < d; b++)
                    c->all.W[((long)e * d + a) * d + b] = answer_of(c->system, c, i * d + a, (from + c->all.near[e]) * d + b);
}
