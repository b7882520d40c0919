/* Steps of the Moreau-Jean scheme: the algorithm of schemes/impacts/moreau.py, many steps in one call. Steps in which points could
   pass through an obstacle, or more contacts close at once than there is room for, are given back with the verdict LOOK. */

#include <stdlib.h>

#include "tables.h"
#include "algebra/rotations.c"
#include "parts.h"
#include "contact/contact.c"
#include "contact/facets.c"
#include "contact/candidates.c"
#include "contact/contact_rows.c"
#include "contact/graph.c"
#include "contact/compliance.c"
#include "algebra/blocks.c"
#include "contact/complementarity.c"
#include "contact/interior.c"
#include "contact/friction.c"
#include "impacts/impulses.c"
#include "impacts/flights.c"
#include "impacts/turns.c"
#include "contact/elastic_books.c"

enum { BOUNDED = AM }; /* of the parameters: whether obstacles are thin, so that points could pass through */
static const double APPROACH = 1e-8, DEEP = 1e-4; /* as in moreau.py */
static const double SLOWLY = 10.0; /* times what a step changes in velocities: rates of touches that need no time of their own */

/* What rates of gaps at a configuration need: the rows of stops, which are those of the last touch, and the motion of obstacles over
   the span h. 1 where Python failed. */
static int rates_known(Contacts *c, Block now, double h)
{
    return (c->stops && touch(c, now.q, *now.t, &c->now)) || gap_rates(c, now.q, *now.t, h, c->rate);
}

/* Contacts that take part in a step, into c->closed: how many, or -1 where Python failed. ``hit``: whether some take an impact;
   then all that touch take part, and those that approach bounce. */
static int taking_part(Contacts *c, const double *p, Block now, double h, int *hit)
{
    int m = 0, fresh = 0;
    const double slow = APPROACH * p[LENGTH] / h;
    for (int k = 0; k < c->candidates; k++) {
        const int i = c->candidate[k];
        fresh |= !c->carrying[i] && c->now.gap[i] <= TOUCHING * p[LENGTH];
    }
    if (fresh && rates_known(c, now, h)) return -1;

    *hit = 0;
    for (int k = 0; k < c->candidates; k++) {
        const int i = c->candidate[k];
        double rate = 0.0;
        c->bouncing[i] = 0;
        if (c->now.gap[i] > (c->carrying[i] ? DRIFTING : TOUCHING) * p[LENGTH]) continue;

        if (!c->carrying[i]) {
            contact_rows(c, i, now.q, &c->now, c->rows);
            rate = along(c, i, c->rows, now.v) + c->rate[i];
        }
        *hit |= c->bouncing[i] = rate < -slow;
        c->closed[m++] = rate > slow ? -1 - i : i;
    }

    /* without an impact those that leave are free */
    int taken = 0;
    for (int k = 0; k < m; k++) {
        int i = c->closed[k];
        if (i < 0 && !*hit) continue;
        c->closed[taken++] = i < 0 ? -1 - i : i;
    }
    return taken;
}

/* Whether a point would pass more than half of an obstacle's thickness in a time h. */
static int passes(Contacts *c, Block now, double h)
{
    for (int i = 0; i < c->size; i++) c->xi[i] = h * now.v[i];
    configuration(c->system, now.q, c->xi, c->ahead);
    if (touch(c, c->ahead, *now.t + h, &c->end)) return 1;
    for (int k = 0; k < c->candidates; k++) {
        const int i = c->candidate[k];
        double way[D], thick = c->pair[c->of[i]].thickness;
        for (int j = 0; j < D; j++) way[j] = c->end.relative[D * i + j] - c->now.relative[D * i + j];
        if (length_of(way) > 0.5 * thick && c->now.gap[i] > -0.1 * thick) return 1;
    }
    return 0;
}

/* Where the state after so many parts of a step is kept. */
static double *station(const System *s, const Contacts *c, int parts) { return c->path + parts * (1 + s->nq + 3 * s->nv + s->rows); }

/* Whether all later impacts of contact i, which hits at a rate, are over within a time: its flights, each e times as long as the one
   before, take 2 e u / (1 - e) / a under an acceleration, here of its gap. */
static int accumulates(const Contacts *c, int i, double acceleration, double rate, double time)
{
    const double e = c->pair[c->of[i]].restitution;
    return -2.0 * e * rate <= -(1.0 - e) * time * acceleration;
}

enum { STRUCK = 4096 }; /* impacts of a call whose instants are kept */

/* A part of almost no length through the impacts of those that bounce; m contacts take part. One whose impacts accumulate comes to rest. */
static int impact(System *s, Contacts *c, double *p, Block now, Block out, int m, double left, double h)
{
    const double time = c->early ? h : left;
    const double *pressing = block_at(s, station(s, c, c->flown)).a;
    c->struck[c->tally.struck++ % STRUCK] = *now.t;
    for (int k = 0; k < c->candidates; k++) {
        const int i = c->candidate[k];
        if (!c->bouncing[i]) continue;
        c->tally.impacts++;
        contact_rows(c, i, now.q, &c->now, c->rows);
        c->bouncing[i] = !accumulates(c, i, along(c, i, c->rows, pressing), along(c, i, c->rows, now.v) + c->rate[i], time);
        if (!c->bouncing[i] && !c->hits[i] && c->pair[c->of[i]].restitution > 0.0) c->hits[i] = 1, c->rested[i] = *now.t;
    }
    int verdict = solved(s, c, p, now, out, m, INSTANT * h, h);
    return verdict ? verdict : taken(s, c, p, now, out, m, INSTANT * h, h);
}

/* Contacts that would leave for a moment only take part as well: how many do then, or -1 where Python failed. ``hit``: in joints
   flights end at the touch, so those that approach take an impact, and they alone are added to those that touch; so do those without
   joints that would end far below zero if they were closed at their speed. */
static int holding(System *s, Contacts *c, double *p, Block now, int m, double h, int *hit)
{
    const int *open = c->hits + c->points;
    const double fast = s->rows ? APPROACH * p[LENGTH] / h : DEEP * p[LENGTH] / h;
    if (rates_known(c, now, h)) return -1;
    *hit = 0;
    for (int k = 0; k < c->candidates; k++) {
        const int i = c->candidate[k];
        if (open[i] != 0) continue;
        contact_rows(c, i, now.q, &c->now, c->rows);
        c->bouncing[i] = along(c, i, c->rows, now.v) + c->rate[i] < -fast;
        *hit |= c->bouncing[i];
    }

    /* slow touches are still to come */
    for (int k = m - 1; *hit && k >= 0; k--) {
        const int i = c->closed[k];
        if (c->carrying[i] || c->now.gap[i] <= TOUCHING * p[LENGTH]) continue;
        c->bouncing[i] = 0;
        c->closed[k] = c->closed[--m];
    }
    for (int k = 0; k < c->candidates; k++) {
        const int i = c->candidate[k];
        if (open[i] == 0 && (!*hit || c->bouncing[i])) c->closed[m++] = i;
    }
    return m;
}

/* Contacts that a flight brings from above their obstacle into it, by less than closed ones drift: they take part in all of it, with
   their impact, and no time of their own: those that are slow for what a step changes in velocities, and where contacts do not rest
   ``early`` those whose impacts are over then. In short steps fast ones are as near. How many more take part, or -1 where
   Python failed. */
static int slow_touches(System *s, Contacts *c, double *p, Block now, Block out, int m, double length, double h)
{
    const double near = DRIFTING * p[LENGTH];
    double *row = c->rows + 2 * c->wide * c->components * m;
    int *closed = c->hits + c->points, more = 0;
    if (along_parabola(s, c, now, out, length, 1.0)) return -1;
    for (int k = 0; k < c->candidates; k++) closed[c->candidate[k]] = 0;
    for (int k = 0; k < m; k++) closed[c->closed[k]] = 1;

    for (int k = 0; k < c->candidates; k++) {
        const int i = c->candidate[k];
        const double from = c->now.gap[i], to = c->aside.gap[i];
        if (!closed[i] && from > TOUCHING * p[LENGTH] && from <= near && to < 0.0 && to >= -near) c->closed[m + more++] = i;
    }
    if (!more || m + more > c->room) return 0;

    /* rates of moving obstacles take the place of gaps */
    if (gap_rates(c, c->ahead, *now.t + length, h, c->rate) || along_parabola(s, c, now, out, length, 1.0)) return -1;
    for (int i = 0; i < s->nv; i++) out.a[i] = (out.v[i] - now.v[i]) / length;
    const double slow = SLOWLY * h * largest_of(s->units, out.a, s->nv);
    int kept = 0;
    for (int k = m; k < m + more; k++) {
        const int i = c->closed[k];
        contact_rows(c, i, c->ahead, &c->aside, row);
        double rate = along(c, i, row, out.v) + c->rate[i], time = h;
        const double pull = along(c, i, row, out.a);
        if (!c->early) {
            const double last = rate;
            rate = -sqrt(fmax(last * last - 2.0 * pull * c->aside.gap[i], 0.0));
            time = pull < 0.0 ? (last - rate) / pull : 0.0;
        }
        c->bouncing[i] = !accumulates(c, i, pull, rate, time);
        if (c->early ? -rate <= slow : !c->bouncing[i]) c->closed[m + kept++] = i;
    }
    return kept;
}

/* Whether a contact whose rate is known approaches faster than resting ones do in steps h. */
static int approaches(Contacts *c, const double *p, Block now, int i, double h)
{
    contact_rows(c, i, now.q, &c->now, c->rows);
    return along(c, i, c->rows, now.v) + c->rate[i] < -APPROACH * p[LENGTH] / h;
}

/* The rest of a step by classical time stepping: contacts closed in the middle, and after many impacts those that would else end in
   their obstacles, all with restitution. An impact is somewhere about the middle. */
static int classical(System *s, Contacts *c, double *p, Block now, Block out, double left, double h)
{
    int m = 0, verdict, hit = 0, *closed = c->hits + c->points;
    for (int i = 0; i < s->nv; i++) c->xi[i] = 0.5 * left * now.v[i];
    configuration(s, now.q, c->xi, c->ahead);
    if (touch(c, c->ahead, *now.t + 0.5 * left, &c->aside)) return LOOK;
    for (int k = 0; k < c->candidates; k++) {
        const int i = c->candidate[k];
        c->bouncing[i] = 1;
        m += closed[i] = c->aside.gap[i] <= 0.0;
    }
    if (m && rates_known(c, now, h)) return LOOK;
    for (int k = 0; k < c->candidates; k++) hit |= closed[c->candidate[k]] && approaches(c, p, now, c->candidate[k], h);

    for (int through = 1; through;) {
        m = through = 0;
        for (int k = 0; k < c->candidates; k++)
            if (closed[c->candidate[k]] > 0) c->closed[m++] = c->candidate[k];
        if ((verdict = solved(s, c, p, now, out, m, left, left))) return verdict;
        if (!c->most) break;
        if (along_parabola(s, c, now, out, left, 1.0)) return LOOK;

        for (int k = 0; k < c->candidates; k++) {
            const int i = c->candidate[k];
            if (closed[i] <= 0 && c->aside.gap[i] < -DRIFTING * p[LENGTH]) through = closed[i] = c->bouncing[i] = 1;
        }
    }
    if (hit) c->struck[c->tally.struck++ % STRUCK] = *now.t + 0.5 * left;
    return taken(s, c, p, now, out, m, left, h);
}

/* The part of a step h to the next impact, through it, or to the end, for which ``left`` is left; ``many``: whether it had too many already. */
static int part(System *s, Contacts *c, double *p, Block now, Block out, double left, double h, int many)
{
    int hit, which, verdict, held;
    double length = left, share;
    c->here = now;
    if (!c->known && touch(c, now.q, *now.t, &c->now)) return LOOK;
    c->known = 1;
    if (c->meetings && pair_surfaces(c, 4.0 * left * fastest_node(c, now.v), &c->now)) return LOOK;
    if (p[BOUNDED] != 0.0 && passes(c, now, left)) return LOOK;
    if (many) return classical(s, c, p, now, out, left, h);
    int m = taking_part(c, p, now, h, &hit);
    if (m < 0) return LOOK;
    if (hit) return impact(s, c, p, now, out, m, left, h);

    for (;;) {
        if ((verdict = solved(s, c, p, now, out, m, length, length))) return verdict;
        if ((held = slow_touches(s, c, p, now, out, m, length, h)) < 0) return LOOK;
        if (held) {
            m += held;
            continue;
        }

        if ((verdict = next_touch(s, c, p, now, out, m, length, &share, &which, &held))) return verdict;
        if (!held) break;
        if ((m = holding(s, c, p, now, m, h, &hit)) < 0) return LOOK;
        if (hit) return impact(s, c, p, now, out, m, left, h);
    }
    if (share < 1.0 && (verdict = located(s, c, p, now, out, m, which, &length, share))) return verdict;
    if ((verdict = turned(s, c, p, now, out, m, length, APPROACH * p[LENGTH] / h))) return verdict;
    return taken(s, c, p, now, out, m, length, h);
}

/* What a step changes beside the state: kept, or put back. */
static void keep_books(Contacts *c, int back)
{
    double *places[] = {c->works, &c->energy, &c->springs}, *held = c->saved, *impulse = held + c->points * c->components;
    double *at = impulse + c->laws * D;
    size_t sizes[] = {5, 1, 1};
    for (int k = 0; k < 3; at += sizes[k++]) {
        if (back) memcpy(places[k], at, sizes[k] * sizeof(double));
        else memcpy(at, places[k], sizes[k] * sizeof(double));
    }

    /* those of pairs are kept when they come near */
    for (int k = 0; back && k < c->nears; k++) {
        const Pair *o = c->pair + c->near[k];
        const int d = c->components;
        memcpy(c->held + o->first * d, held + o->first * d, o->count * d * sizeof(double));
        memcpy(c->impulse + c->near[k] * D, impulse + c->near[k] * D, D * sizeof(double));
        memcpy(c->carrying + o->first, c->was + o->first, o->count * sizeof(int));
    }
}

/* The state after so many parts of a step is kept. */
static void note_part(const System *s, Contacts *c, int parts, const double *state)
{
    memcpy(station(s, c, parts), state, (1 + s->nq + 3 * s->nv + s->rows) * sizeof(double));
    c->parts = parts;
}

/* What the step leaves of each candidate and of the work, when its last part is made. */
static void end_of_parts(Contacts *c, double *p)
{
    int acts = 0;
    for (int k = 0; k < c->candidates; k++) {
        const int i = c->candidate[k];
        acts |= c->normal[i] != 0.0;
        if (c->hits[i]) c->python(RESTED, i, c->rested[i]);
    }
    if (acts) c->tally.steps++, c->tally.newton += c->total;
    p[LOCAL] = fmax(p[LOCAL], c->last);
}

/* A whole step from ring[0], in parts; where the newest state is then. */
static int whole_step(System *s, Contacts *c, double *p, double **ring, int *newest)
{
    const double h = p[H], end = *block_at(s, ring[0]).t + h;
    int from = 0, to = 1, verdict;
    c->total = c->flown = 0;
    c->here = block_at(s, ring[0]);
    if (begin_list(c, h, p[LENGTH])) return LOOK;
    note_part(s, c, 0, ring[0]);

    for (int done = 0; end - *block_at(s, ring[from]).t > 2 * INSTANT * h; done++) {
        Block now = block_at(s, ring[from]);
        if ((verdict = part(s, c, p, now, block_at(s, ring[to]), end - *now.t, h, done >= c->most))) return verdict;
        from = to;
        to = 3 - to;
        note_part(s, c, done + 1, ring[from]);

        const Block made = block_at(s, ring[from]);
        if (*made.t - *now.t <= 2 * INSTANT * h) continue;
        c->flown = done + 1;
        if (!s->remembers || end - *made.t <= 2 * INSTANT * h) continue;
        if ((verdict = place(s, made.q, made.v))) return verdict;
        drag_friction(s, *made.t);
    }
    *block_at(s, ring[from]).t = end;
    end_of_parts(c, p);
    *newest = from;
    return DONE;
}

/* What a record tells of contacts, one array behind the other: gaps, places, normals, normal forces, forces, impulses, works, time. */
static void record_contacts(const Contacts *c, double *to)
{
    const int m = c->points;
    const double *from[] = {c->now.gap, c->now.x, c->now.normal, c->normal, c->force, c->impulse, c->works, &c->time};
    const int sizes[] = {m, m * D, m * D, m, m * D, c->laws * D, 5, 1};
    for (int k = 0; k < 8; to += sizes[k++]) memcpy(to, from[k], sizes[k] * sizeof(double));
}

/* Gaps of all points at so many states, one block behind the other, each in front of ``wide`` numbers; surfaces are paired there, where
   nodes are as near as ``reach``. 1 where Python failed. */
EXPORT int moreau_gaps(Contacts *c, long count, double *block, long wide, double *gap, double reach)
{
    const System *s = c->system;
    const long size = 1 + s->nq + 3 * (long)s->nv + s->rows;
    for (long i = 0; i < count; i++, block += size, gap += wide) {
        const Block now = block_at(s, block);
        if (placed(c, now.q)) return 1;
        for (int k = 0; k < c->laws; k++)
            if (touch_pair(c, c->pair + k, now.q, *now.t, &c->aside)) return 1;
        if (pair_surfaces(c, reach, &c->aside)) return 1;
        memcpy(gap, c->aside.gap, c->points * sizeof(double));
    }
    return 0;
}

/* Keep the parts of the newest step, from the state ``begin`` on, in which instants lie, with its contacts. */
static void keep_parts(const System *s, const Contacts *c, Tape *tape, const double *begin, const double *end)
{
    Kept *o = tape->kept;
    o->steps++;
    for (int i = 1; i <= c->parts && awaited(tape, *end); i++) {
        const double *to = i < c->parts ? station(s, c, i) : end;
        const double until = i < c->parts ? *to : *to + o->roundoff;
        if (o->instant[o->passed] <= until) record_contacts(c, keep_between(s, o, station(s, c, i - 1), to, until));
    }
    memcpy(o->last, begin, (1 + s->nq + 3 * (long)s->nv + s->rows) * sizeof(double));
}

/* The newest state, whose step is accepted: elements remember it, and it is recorded where that is due. */
static int accepted(System *s, Contacts *c, Block now, Tape *tape)
{
    const int recorded = tape && tape->left == 1, waits = tape && awaited(tape, *now.t);
    int verdict;
    if (recorded || waits || s->remembers) {
        if ((verdict = place(s, now.q, now.v))) return verdict;
        if ((recorded || waits) && s->samples && s->python(SAMPLE, 0, *now.t)) return FAILED;
    }
    if ((recorded || waits) && touch_others(c, now.q, *now.t)) return LOOK;

    if (recorded) {
        const long size = c->points * (2 + 3 * D) + c->laws * D + 6;
        record_contacts(c, tape->contact + size * place_on(tape));
        if ((verdict = record(s, tape, &now, 0, 1))) return verdict;
    } else if (waits) {
        judge_drift(s, tape, &now);
    }
    if (s->remembers && (verdict = keep(s, *now.t))) return verdict;
    if (tape) tape->left = recorded ? tape->every : tape->left - 1;
    return DONE;
}

/* Up to ``steps`` steps from ring[0]; the other two are free. Returns how many were made; ring[0] is then the newest. ``tape`` (may
   be NULL) takes records. */
EXPORT long moreau_march(System *s, Contacts *c, double *p, long steps, double **ring, int *verdict, Tape *tape)
{
    long made = 0;
    int newest;
    *verdict = DONE;
    while (made < steps) {
        double theta = p[THETA], iterations = p[ITERATIONS], left = p[LEFT];
        Tally tally = c->tally;
        keep_books(c, 0);
        if (s->remembers) hold_friction(s, 0);

        if ((*verdict = whole_step(s, c, p, ring, &newest))) {
            p[THETA] = theta, p[ITERATIONS] = iterations, p[LEFT] = left;
            c->tally = tally;
            c->known = 0;
            keep_books(c, 1);
            if (s->remembers) hold_friction(s, 1);
            break;
        }

        double *last = ring[newest];
        ring[newest] = ring[0];
        ring[0] = last;
        made++;
        if ((*verdict = accepted(s, c, block_at(s, last), tape))) break;
        if (!tape || !tape->kept) continue;
        keep_parts(s, c, tape, ring[newest], last);
        if (is_full(tape->kept)) break;
    }
    if (made && touch_others(c, block_at(s, ring[0]).q, *block_at(s, ring[0]).t)) *verdict = LOOK;
    return made;
}
