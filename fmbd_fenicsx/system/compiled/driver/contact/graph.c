/* Which closed contacts move each other: those on bodies that joints or forces connect. They are put in order, group by group, as the
   matrices of blocks.c are eliminated: by least degree (Tinney and Walker, doi:10.1109/PROC.1967.6011). A set of contacts is ordered
   once. */

enum { WORD = 64 }; /* bits */

/* Trees of the factor that contact i acts on; -2 where it acts on one only. */
static void trees_of(const Contacts *c, int i, int *trees)
{
    for (int side = 0; side < 2; side++) {
        const int body = c->on[2 * i + side];
        trees[side] = body < 0 ? -2 : c->tree_of[body];
    }
    if (trees[0] == trees[1]) trees[1] = -2;
}

/* Lists of the m closed contacts of each tree: 2 k + side. */
static void list_trees(Contacts *c, int m)
{
    Graph *g = &c->graph;
    for (int t = 0; t < c->trees; t++) g->head[t] = -1;
    for (int k = m - 1; k >= 0; k--) {
        int trees[2];
        trees_of(c, g->gathered[k], trees);
        for (int side = 0; side < 2; side++) {
            if (trees[side] < 0) continue;
            g->next[2 * k + side] = g->head[trees[side]];
            g->head[trees[side]] = 2 * k + side;
        }
    }
}

/* Those that closed contact k shares a tree with, into ``found``, each once, itself left out: how many. ``seen`` tells by ``stamp``. */
static int around(Contacts *c, int k, int stamp, int *found)
{
    Graph *g = &c->graph;
    int trees[2], count = 0;
    trees_of(c, g->gathered[k], trees);
    g->seen[k] = stamp;
    for (int side = 0; side < 2; side++)
        for (int e = trees[side] < 0 ? -1 : g->head[trees[side]]; e >= 0; e = g->next[e])
            if (g->seen[e / 2] != stamp) g->seen[e / 2] = stamp, found[count++] = e / 2;
    return count;
}

/* Bits of which of the contacts in g->member, so many, share trees; their numbers there are in g->place. */
static void share_bits(Contacts *c, int count, int words, int *stamp)
{
    Graph *g = &c->graph;
    memset(g->bits, 0, (size_t)count * words * sizeof(unsigned long));
    for (int i = 0; i < count; i++) {
        const int near = around(c, g->member[i], ++*stamp, g->found);
        for (int k = 0; k < near; k++) {
            const int other = g->place[g->found[k]];
            g->bits[(long)i * words + other / WORD] |= 1UL << other % WORD;
        }
    }
}

/* The order of elimination of a group into g->order, and the rows that fill behind each, by the numbers of bits. */
static void eliminate_group(Graph *g, int count, int words, int from)
{
    unsigned long *left = g->bits + (long)count * words;
    for (int w = 0; w < words; w++) left[w] = ~0UL;
    for (int i = 0; i < count; i++) g->order[i] = i;
    for (int p = 0; p < count; p++) {
        int least = p, fewest = count + 1, fills = g->start[from + p];
        for (int i = p; i < count; i++) {
            const unsigned long *row = g->bits + (long)g->order[i] * words;
            int degree = 0;
            for (int w = 0; w < words; w++) degree += __builtin_popcountl(row[w] & left[w]);
            if (degree < fewest) least = i, fewest = degree;
        }

        const int one = g->order[least];
        g->order[least] = g->order[p];
        g->order[p] = one;
        left[one / WORD] &= ~(1UL << one % WORD);

        const unsigned long *row = g->bits + (long)one * words;
        for (int i = p + 1; i < count; i++) {
            const int other = g->order[i];
            if (!(row[other / WORD] >> other % WORD & 1)) continue;
            g->behind[fills++] = other;
            unsigned long *to = g->bits + (long)other * words;
            for (int w = 0; w < words; w++) to[w] |= row[w] & left[w];
            to[other / WORD] &= ~(1UL << other % WORD);
        }
        g->start[from + p + 1] = fills;
    }
}

/* Where a number is in an ascending list that holds it. */
static int found_in(const int *list, int from, int to, int number)
{
    while (from < to) {
        const int middle = (from + to) / 2;
        if (list[middle] < number) from = middle + 1;
        else to = middle;
    }
    return from;
}

/* The contacts in g->member as a group that begins at ``from``. */
static void add_group(Contacts *c, int count, int from, int *stamp)
{
    Graph *g = &c->graph;
    const int words = (count + WORD - 1) / WORD;
    for (int i = 0; i < count; i++) g->place[g->member[i]] = i;
    share_bits(c, count, words, stamp);
    eliminate_group(g, count, words, from);

    /* from the numbers of bits to those in the order */
    for (int p = 0; p < count; p++) g->found[g->order[p]] = p;
    for (int e = g->start[from]; e < g->start[from + count]; e++) g->behind[e] = g->found[g->behind[e]];
    for (int i = 0; i < count; i++) g->place[g->member[i]] = g->found[i];

    for (int p = 0; p < count; p++) {
        const int one = g->member[g->order[p]];
        int *list = g->near + g->first[from + p];
        qsort(g->behind + g->start[from + p], g->start[from + p + 1] - g->start[from + p], sizeof(int), ascending);
        g->arranged[from + p] = g->gathered[one];
        const int near = around(c, one, ++*stamp, list);
        for (int k = 0; k < near; k++) list[k] = g->place[list[k]];
        qsort(list, near, sizeof(int), ascending);
        g->first[from + p + 1] = g->first[from + p] + near;
    }

    for (int p = 0; p < count; p++)
        for (int e = g->first[from + p]; e < g->first[from + p + 1]; e++) {
            const int low = from + (g->near[e] < p ? g->near[e] : p), high = g->near[e] < p ? p : g->near[e];
            g->slot[e] = found_in(g->behind, g->start[low], g->start[low + 1], high);
        }
}

/* The closed contacts in the order of their groups and of elimination. */
static void arrange(Contacts *c, int m)
{
    Graph *g = &c->graph;
    const size_t size = m * sizeof(int);
    if (m == g->m && !memcmp(c->closed, g->arranged, size)) return;

    if (m != g->m || memcmp(c->closed, g->gathered, size)) {
        int from = 0, stamp = 0;
        g->m = m;
        g->groups = 0;
        memcpy(g->gathered, c->closed, size);
        memset(g->seen, 0, size);
        memset(g->taken, 0, size);
        list_trees(c, m);
        for (int k = 0; k < m; k++) {
            if (g->taken[k]) continue;

            int count = 1;
            g->member[0] = k;
            g->taken[k] = 1;
            for (int done = 0; done < count; done++) {
                const int near = around(c, g->member[done], ++stamp, g->found);
                for (int i = 0; i < near; i++)
                    if (!g->taken[g->found[i]]) g->taken[g->found[i]] = 1, g->member[count++] = g->found[i];
            }

            add_group(c, count, from, &stamp);
            g->group[g->groups++] = from;
            from += count;
        }
        g->group[g->groups] = from;
    }
    memcpy(c->closed, g->arranged, size);
}
