/* Contact of points with obstacles, and stops of joint coordinates: gaps, normals and rows, as mechanics/contact/rows.py, shapes.py
   and limits.py define them.

   Points are fixed in a body, or nodes of a reduced one or of a field. An obstacle is at rest, moves as prescribed (Python gives its
   pose), or is carried by a body. A stop is a pair of its own, whose one or two candidates are the lower and the upper one. The nodes of
   a surface that touches no obstacle but another surface are a pair of their own, too. */

enum { HALF_SPACE, SPHERE, CYLINDER, BOX, SURFACE, LIMIT, OWN, MEETING }; /* OWN: Python tells the distances; MEETING: see facets.c */
enum { POSE_OF, COMPLEMENTARITY, DISTANCES, RESTED, NEARBY, FACETS }; /* what Python is asked for, or told, by contact */
enum { TOLD = 8 };                                     /* poses of a moving obstacle that are kept: those of the times of a step */

typedef struct {
    int shape, first, count, carrier, moving; /* points; carrier: body, -1 for none */
    double radius, friction, restitution, thickness;
    double data[16];                          /* of the shape: see schemes/impacts/compiled/driver.py */
    double pose[POSE];                        /* of an obstacle that no body carries, */
    double told[TOLD * POSE], asked[TOLD];    /* of one that moves those told last, and their times; */
    long oldest;                              /* which of them is the oldest */
    double *modes;                            /* count x D x modes: of nodes of a reduced body, NULL for points fixed in a body */
    int *node;                                /* count: of nodes of a field, where in q their displacements are; else NULL */
    double extent;                            /* of the body of these nodes, m */
    struct Meeting *meeting;                  /* MEETING: of whose surfaces, see facets.c */
    Batch *batch;                             /* LIMIT: of the coordinate, which is its item; */
    long item;
    int mover;                                /* the sphere of its points; -1: may be anywhere */
    int pushes, marked;                       /* whether it acts along a direction; the frame of its point, */
    double mark[D], lever, bound[2], side[2]; /* where that is; m or 1; stops; +1 below, -1 above */
} Pair;

/* A sphere at a place of a body, around points or a shape: how far they are from its middle, and how far it reaches. */
typedef struct {
    int body;
    double place[D], extent, reach;
} Mover;

/* Where all points stand: gaps, places and normals in world axes, places in the axes of the obstacle. */
typedef struct {
    double *gap, *x, *normal, *relative;
} Touch;

/* What is counted of contacts, and Newton's iterations on parts of steps; a step that is given back counts nothing. */
typedef struct {
    long solves, iterations, changes, cycles, steps, newton, impacts, products, struck, iterated;
    double residual;
} Tally;

/* The small problem of a group of m closed contacts: openings u = q + W f, friction mu. Beside forces on light bodies between heavy ones
   W knows them to few digits: they are taken as what the change from the forces ``held``, under which they are ``opened``, adds. */
typedef struct {
    int m;
    int *first, *near, *slot;                 /* of each those that it moves, their blocks of W, and where these are in a factor */
    int *start, *behind;                      /* of each those behind it in a factor */
    double *own, *W;                          /* blocks on the diagonal, and beside it */
    double *q, *u, *f, *mu, *held, *opened, *change;
    struct Lumped *lumped;                    /* where W is known by its products: what is nearly its inverse; else NULL */
} Problem;

/* Closed contacts in the order of their groups, see graph.c. */
typedef struct {
    int m, groups;
    int *gathered, *arranged, *group;         /* as they were found, and in order; where groups begin */
    int *first, *near, *slot, *start, *behind; /* of all groups; see Problem */
    int *head, *next, *seen, *taken, *member, *found, *place, *order;
    unsigned long *bits;
} Graph;

/* Matrices of a group: blocks on the diagonal and their sizes; those behind it by rows, and those below it in the transposed places. */
typedef struct {
    double *own, *size, *upper, *lower;
} Blocks;

/* What is nearly W^-1, (2) of linear/complementarity/delassus_matrix_free.py, and who makes products of W. */
typedef struct Lumped {
    Problem inverse;                          /* its blocks and those that fill, in an order of elimination */
    Blocks blocks;
    int *place, *of, *still;                  /* of contacts: where they are in that order, and back; whether they stay where they are */
    double *work, scale;                      /* 2 m d (1 + d); W = scale N A^-1 N^T */
    void (*times)(const void *by, const double *x, double *y);
    const void *by;
} Lumped;

typedef struct {
    int pairs, laws, points, components;      /* pairs with laws stand first, then the surfaces of those that meet; points of laws */
    int known;                                /* whether ``now`` is that of the newest state */
    int room, moving;                         /* contacts that may be closed at once; whether obstacles move as prescribed */
    Pair *pair;
    int meetings;                             /* pairs of surfaces, see facets.c; */
    struct Meeting *meeting;
    int *surface;                             /* laws x 2: the pairs whose points rows act on, -1 for none */
    struct Means *means;                      /* laws x 2: of these points */
    double *offset;                           /* points: overlaps that are not pushed out, m */
    int stops, wide;                          /* whether there are stops; TWIST and the most modes of a body */
    int *on, *of;                             /* points x 2: bodies, -1 for none; points: pair */
    double *place, *still;                    /* points x D: in the body; velocities of a system at rest */
    Touch now, end, aside;
    int movers, singles;                      /* spheres; pairs without two of them: */
    Mover *mover;
    int *single, *start, *partner;            /* movers + 1; of each sphere with higher ones: these and the pairs, by twos */
    int *order;                               /* spheres, see sweep(); */
    double *lower, *stood, skin;              /* their lower ends; where they were when the list was made, with what is between */
    int nears, candidates, *near, *listed;    /* pairs near, ascending; all pairs: 1, 2 with its books; */
    int *candidate;                           /* points of these */
    Block here;                               /* where the part of a step begins */
    int *carrying, *closed, *bouncing, *hits; /* points; hits: whether impacts accumulate in a step */
    double *held, *force, *normal;            /* points x components: forces in flights; points x D: mean ones of a step, world axes; */
                                              /* points: their normal parts */
    double *impulse, *works;                  /* laws x D; 5: see sensors/contact.py */
    double energy, springs, time, last;       /* time: when forces act; last: error of the last part */
    int loaded;                               /* whether there are force elements */
    double *rows, *drift, *rate;              /* of closed contacts: components x 2 wide, body axes; tangential; of gaps */
    double *before, *rebound;                 /* of closed contacts: rates before a part; what normals that bounce come back with */
    double *slip;                             /* of closed contacts at the start of a flight, along the axes of its middle */
    Problem all;                              /* of all closed contacts */
    int unsolved;                             /* contacts of the group whose forces were not found in a march */
    Graph graph;
    Blocks blocks;
    int trees;                                /* parts of the factor that nothing couples; */
    Tree *tree;
    int *tree_of;                             /* of bodies */
    int *known_of;                            /* of groups: whether W is known beside the diagonal */
    double *Y;                                /* A^-1 L^T on the trees of a contact */
    double *push;                             /* like v: what forces add to an increment, */
    double *open;                             /* to openings; */
    double *turns;                            /* of bodies where compliances were found */
    double *old;                              /* impulses before an iteration */
    double *least;                            /* room for vectors of forces; */
    int *states;                              /* of contacts, twice */
    double rough;                             /* m/s: what iterations leave of velocities, and so of rates of gaps and slips */
    double *ahead, *xi, *kept;                /* like q, like v, like lambda */
    double *saved;                            /* held, impulse, works and energies at the start of a step, of what is near */
    int *was;                                 /* carrying then */
    double *struck;                           /* the newest instants of impacts (s) since they were counted: STRUCK of them, in turn */
    double *rested;                           /* points: when one whose impacts accumulate in a step came to rest */
    double *path;                             /* most + 2 states: the start of a step and the ends of its parts */
    double *own;                              /* for Python: places of the points in a shape's axes, distances, gradients */
    int size, most, done, total;              /* of v; impacts' parts of a step; iterations of a part and of the parts of a step */
    int parts, flown;                         /* of the last step; where the last flight of it led to */
    int early;                                /* whether contacts rest as soon as impacts are over within a step, see moreau.py */
    System *system;
    Tally tally;
    int (*python)(int what, int number, double t);
} Contacts;

static double length_of(const double *x) { return sqrt(dot(x, x, D)); }

/* Distance to the intersection of two orthogonal convex sets at distances a, b. */
static double rounded(double a, double b, const double *na, const double *nb, double *n)
{
    double d = a > 0 && b > 0 ? hypot(a, b) : fmax(a, b), w = a >= b, u = a < b;
    if (a > 0 && b > 0) w = a / d, u = b / d;
    for (int i = 0; i < D; i++) n[i] = w * na[i] + u * nb[i];
    return d;
}

/* data: axis, centre, radius, length */
static double cylinder(const double *data, const double *y, double *n)
{
    double r[D], side[D], cap[D], z, rho;
    for (int i = 0; i < D; i++) r[i] = y[i] - data[D + i];
    z = dot(r, data, D);
    for (int i = 0; i < D; i++) side[i] = r[i] - z * data[i];
    rho = length_of(side);
    for (int i = 0; i < D; i++) {
        side[i] /= rho > 0 ? rho : 1.0;
        cap[i] = (z > 0) - (z < 0) ? ((z > 0) - (z < 0)) * data[i] : 0.0;
    }

    double radius = data[6], length = data[7];
    if (isfinite(length)) return rounded(rho - radius, fabs(z) - 0.5 * length, side, cap, n);
    memcpy(n, side, D * sizeof(double));
    return rho - radius;
}

/* data: half edges, centre, directions of the edges one by one */
static double box(const double *data, const double *y, double *n)
{
    const double *axes = data + 2 * D;
    double far = 0.0, inner = -INFINITY, outside[D], sign[D];
    int nearest = 0;
    for (int i = 0; i < D; i++) {
        double r = 0.0, over;
        for (int k = 0; k < D; k++) r += axes[D * i + k] * (y[k] - data[D + k]);
        over = fabs(r) - data[i];
        sign[i] = r < 0 ? -1.0 : 1.0;
        outside[i] = fmax(over, 0.0);
        if (over > inner) inner = over, nearest = i;
    }

    far = length_of(outside);
    memset(n, 0, D * sizeof(double));
    for (int i = 0; i < D; i++) {
        double along = far > 0 ? sign[i] * outside[i] / far : sign[i] * (i == nearest);
        for (int k = 0; k < D; k++) n[k] += along * axes[D * i + k];
    }
    return far > 0 ? far : inner;
}

/* Signed distance and its gradient at y, in the shape's axes. */
static double distance(const Pair *o, const double *y, double *n)
{
    const double *data = o->data;
    if (o->shape == CYLINDER) return cylinder(data, y, n);
    if (o->shape == BOX) return box(data, y, n);
    if (o->shape == HALF_SPACE) { /* normal, its level */
        memcpy(n, data, D * sizeof(double));
        return dot(y, data, D) - data[D];
    }

    /* centre, radius, 1 or -1 for a hollow */
    double r[D], length, sign = data[D + 1];
    for (int i = 0; i < D; i++) r[i] = y[i] - data[i];
    length = length_of(r);
    for (int i = 0; i < D; i++) n[i] = sign * (length > 0 ? r[i] / length : i == 0);
    return sign * (length - data[D]);
}

/* Place and rotation of an obstacle; 1 where Python failed. */
static int obstacle(const Contacts *c, Pair *o, const double *q, double t, double *r, double *R)
{
    const double *pose = o->carrier >= 0 ? q + POSE * o->carrier : o->pose;
    if (o->moving) {
        int k = 0;
        while (k < TOLD && o->asked[k] != t) k++;
        if (k == TOLD) {
            if (c->python(POSE_OF, (int)(o - c->pair), t)) return 1;
            k = (int)o->oldest;
            o->oldest = (k + 1) % TOLD;
            o->asked[k] = t;
            memcpy(o->told + POSE * k, o->pose, POSE * sizeof(double));
        }

        pose = o->told + POSE * k;
    }

    memcpy(r, pose, D * sizeof(double));
    rotation(pose, R);
    return 0;
}

/* Frames at a configuration, for stops; 1 where it is refused. */
static int placed(const Contacts *c, const double *q) { return c->stops && place(c->system, q, c->still) != DONE; }

/* The stops of a joint coordinate at the frames placed last. */
static void stand(const Contacts *c, const Pair *o, Touch *out)
{
    Batch *k = o->batch;
    const double *frames = c->system->frames, *frame = frames + FRAME * o->marked;
    double *s = k->out + k->outputs * o->item, y[2 * TWIST];
    k->value(1, k->pair + 2 * o->item, frames, k->P + k->width * o->item, 0, s);
    twist_row(k, o->item, y);

    for (int side = 0; side < o->count; side++) {
        int i = o->first + side;
        double *x = out->x + D * i, *n = out->normal + D * i;
        out->gap[i] = o->lever * o->side[side] * (s[0] - o->bound[side]);
        times(frame + TURN, o->mark, x);
        add(x, 1.0, frame, D);
        for (int j = 0; j < D; j++) n[j] = o->pushes ? o->side[side] * y[TWIST + j] : 0.0;
    }
}

/* What the coordinates x of its body alone do to point i of a pair, in its axes: nothing to one that is fixed there. */
static void add_deformed(const Body *body, const Pair *o, int i, const double *x, double *P)
{
    if (o->node) add(P, 1.0, x + o->node[i - o->first] - body->at_q, D);
    if (!o->modes) return;
    const double *modes = o->modes + (long)D * body->modes * (i - o->first);
    for (int j = 0; j < D; j++) P[j] += dot(modes + j * body->modes, x, body->modes);
}

/* A bound of the speed of all nodes of surfaces: what their bodies do, and what deforms these. */
static double fastest_node(const Contacts *c, const double *v)
{
    double fastest = 0.0;
    for (const Pair *k = c->pair; k < c->pair + c->pairs; k++) {
        if (k->meeting || !(k->node || k->modes)) continue;
        const int b = c->on[2 * k->first];
        const Body *body = c->system->body + b;
        double turning = 0.0, speed = 0.0, most = 0.0;
        for (int j = 0; j < D; j++) speed += fabs(v[TWIST * b + j]);
        for (int j = D; j < TWIST; j++) turning += fabs(v[TWIST * b + j]);
        for (int i = k->first; i < k->first + k->count; i++) {
            double rate[D] = {0.0};
            add_deformed(body, k, i, v + body->at_v, rate);
            most = fmax(most, length_of(rate));
        }
        fastest = fmax(fastest, most + (rests(body) ? 0.0 : speed + turning * k->extent));
    }
    return fastest;
}

/* Signed distances and gradients of the points of an own shape, all in one call; 1 where Python failed. */
static int own_distances(const Contacts *c, const Pair *o, const Touch *out, double t)
{
    memcpy(c->own + D * o->first, out->relative + D * o->first, D * o->count * sizeof(double));
    return c->python(DISTANCES, (int)(o - c->pair), t);
}

/* Signed distance and gradient of one point, in the shape's axes. */
static double distance_of(const Contacts *c, const Pair *o, int i, const double *y, double *n)
{
    const double *told = c->own + D * c->points;
    if (o->shape != OWN) return distance(o, y, n);
    memcpy(n, told + c->points + D * i, D * sizeof(double));
    return told[i];
}

/* The points of a pair or of a surface at a configuration; those of stops at the frames placed last. 1 where Python failed. */
static int touch_points(const Contacts *c, Pair *o, const double *q, double t, Touch *out)
{
    double r[D], R[D * D];
    if (o->shape == LIMIT) {
        stand(c, o, out);
        return 0;
    }
    if (obstacle(c, o, q, t, r, R)) return 1;

    for (int i = o->first; i < o->first + o->count; i++) {
        const double *pose = q + POSE * c->on[2 * i];
        const Body *body = c->system->body + c->on[2 * i];
        double *x = out->x + D * i, P[D], Rb[D * D], way[D];
        rotation(pose, Rb);
        memcpy(P, c->place + D * i, D * sizeof(double));
        add_deformed(body, o, i, q + body->at_q, P);
        times(Rb, P, x);
        for (int j = 0; j < D; j++) x[j] += pose[j], way[j] = x[j] - r[j];
        transposed(R, way, out->relative + D * i);
    }
    if (o->shape == SURFACE) return 0;
    if (o->shape == OWN && own_distances(c, o, out, t)) return 1;

    for (int i = o->first; i < o->first + o->count; i++) {
        double *x = out->x + D * i, n[D];
        out->gap[i] = distance_of(c, o, i, out->relative + D * i, n) - o->radius;
        times(R, n, out->normal + D * i);
        for (int j = 0; j < D; j++) x[j] -= o->radius * out->normal[D * i + j];
    }
    return 0;
}
