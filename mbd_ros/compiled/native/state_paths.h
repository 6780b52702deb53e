/* Lengths, speeds and moment arms of paths at one configuration, as PointPath and WrappedPath of
 * core/model have them; an entry of a table a struct, as runs/state_paths.py fills them. Surfaces,
 * and with WRAPS the search of paths over them, stand before this file.
 */
#include <stdint.h>

typedef struct {
  int32_t parent, first, count; /* its velocities */
} Joint;

typedef struct {
  double at[3];          /* in axes of the joint that carries it */
  double lower, upper;   /* where the path goes through it */
  int32_t joint, within; /* that carries it; position that says whether it is there, else -1 */
  int32_t slides;        /* velocity that slides it along its link, else -1 */
} Point;

typedef struct {
  double axis[3];
  int32_t point;
} Way;

/* Where a surface is in axes of the joint that carries it: rotation row by row, origin. */
typedef struct {
  double at[12];
  int32_t joint;
} Carried;

typedef struct {
  int64_t paths, joints, points, ways, velocities, couplings, independent, width;
} Counts;

/* Rotation column by column, then origin. */
typedef double Place[12];

typedef struct {
  const Counts *n;
  const Joint *joints;
  const Place *const *places;
  const Point *points;
  const int32_t *begins; /* first point of every path, and the end */
  const Way *ways;
  const double (*slides)[2]; /* how far along every way, and its slope */
  const double (*J)[6];      /* of all velocities, about the origin of the world */
  const double *q, *v;
  const int32_t (*couplings)[2]; /* velocities of child and parent, parents first */
  const double *slopes;
  const int32_t *independent;
  double *length, *speed, *columns;
  double (*at)[3], (*moved)[3], (*seen)[3]; /* of points: in their joint, slope there, in space */
  double (*wrenches)[6], *J_of_path;
#if WRAPS
  const WrapPath *wraps; /* of every path */
  const WrapReach *reaches;
  const Surface *surfaces;
  const Carried *carried;
  double *asked, *found;
#endif
} Frame;

static void turned_out(const double *place, const double *x, double *out) {
  for (int i = 0; i < 3; i++) out[i] = place[i] * x[0] + place[3 + i] * x[1] + place[6 + i] * x[2];
}

static void place_points(const Frame *f) {
  for (int64_t i = 0; i < f->n->points; i++) {
    memcpy(f->at[i], f->points[i].at, sizeof f->at[i]);
    memset(f->moved[i], 0, sizeof f->moved[i]);
  }
  for (int64_t i = 0; i < f->n->ways; i++)
    for (int k = 0; k < 3; k++) {
      f->at[f->ways[i].point][k] += f->slides[i][0] * f->ways[i].axis[k];
      f->moved[f->ways[i].point][k] += f->slides[i][1] * f->ways[i].axis[k];
    }
  for (int64_t i = 0; i < f->n->points; i++) {
    const double *place = *f->places[f->points[i].joint];
    turned_out(place, f->at[i], f->seen[i]);
    for (int k = 0; k < 3; k++) f->seen[i][k] += place[9 + k];
  }
}

static int is_there(const Frame *f, const Point *p) {
  return p->within < 0 || (f->q[p->within] >= p->lower && f->q[p->within] <= p->upper);
}

/* A force on a link, at a point of space. */
static void load(const Frame *f, int32_t joint, const double *x, const double *force, double sign) {
  double *wrench = f->wrenches[joint], torque[3];
  cross3(x, force, torque);
  for (int k = 0; k < 3; k++) {
    wrench[k] += sign * force[k];
    wrench[3 + k] += sign * torque[k];
  }
}

/* A point pulled along a direction by a tension of 1 N: joints that carry or slide it. */
static void pull(const Frame *f, int64_t i, const double *way, double sign) {
  const Point *p = f->points + i;
  double slope[3];
  load(f, p->joint, f->seen[i], way, sign);
  if (p->slides < 0) return;
  turned_out(*f->places[p->joint], f->moved[i], slope);
  f->J_of_path[p->slides] += sign * dot3(slope, way);
}

/* Length of the line; what it pulls at goes to the joints, but where these cannot change it. */
static double line(const Frame *f, int64_t a, int64_t b) {
  const Point *from = f->points + a, *to = f->points + b;
  int is_rigid = from->joint == to->joint && from->slides < 0 && to->slides < 0;
  const double *begin = is_rigid ? f->at[a] : f->seen[a], *end = is_rigid ? f->at[b] : f->seen[b];
  double way[3] = {end[0] - begin[0], end[1] - begin[1], end[2] - begin[2]};
  double length = sqrt(dot3(way, way));
  if (is_rigid || !(length > 0.0)) return length;
  for (int k = 0; k < 3; k++) way[k] /= length;
  pull(f, b, way, 1.0);
  pull(f, a, way, -1.0);
  return length;
}

#if WRAPS
/* Length of a path over its surfaces; no number where none is found. */
static double wrapped(const Frame *f, int64_t path) {
  const WrapPath *of = f->wraps + path;
  int32_t first = f->begins[path];
  double *at = f->asked;
  memcpy(at, f->seen[first], 3 * of->points * sizeof *at);
  at += 3 * of->points;
  for (int w = 0; w < of->wraps; w++, at += 12) {
    const Carried *one = f->carried + of->first + w;
    const double *place = *f->places[one->joint];
    for (int i = 0; i < 9; i++)
      at[i] = place[i / 3] * one->at[i % 3] + place[3 + i / 3] * one->at[3 + i % 3]
              + place[6 + i / 3] * one->at[6 + i % 3];
    turned_out(place, one->at + 9, at + 9);
    for (int k = 0; k < 3; k++) at[9 + k] += place[9 + k];
  }
  find_or_leave(f->surfaces + of->first, of, f->reaches + of->first, f->asked, f->found);
  const double *change = f->found + 1, *origin = f->asked + 3 * of->points + 9;
  for (int i = 0; i < of->points; i++, change += 3) pull(f, first + i, change, 1.0);
  for (int w = 0; w < of->wraps; w++, change += 6, origin += 12) {
    int32_t joint = f->carried[of->first + w].joint;
    load(f, joint, origin, change, 1.0);
    for (int k = 0; k < 3; k++) f->wrenches[joint][3 + k] += change[3 + k];
  }
  return f->found[0];
}
#endif

static double straight(const Frame *f, int64_t path) {
  double length = 0.0;
  int32_t last = f->begins[path];
  for (int32_t i = last + 1; i < f->begins[path + 1]; i++)
    if (is_there(f, f->points + i)) length += line(f, last, i), last = i;
  return length;
}

static double length_of(const Frame *f, int64_t path) {
#if WRAPS
  if (f->wraps[path].wraps) return wrapped(f, path);
#endif
  return straight(f, path);
}

/* Wrenches on links to slopes of all velocities, from the outermost link inwards. */
static void gather(const Frame *f) {
  for (int64_t j = f->n->joints - 1; j > 0; j--) {
    const Joint *joint = f->joints + j;
    double *wrench = f->wrenches[j];
    for (int c = joint->first; c < joint->first + joint->count; c++)
      f->J_of_path[c] += dot3(f->J[c], wrench) + dot3(f->J[c] + 3, wrench + 3);
    for (int k = 0; k < 6; k++) f->wrenches[joint->parent][k] += wrench[k];
  }
}

static void measure(const Frame *f, int64_t path) {
  const Counts *n = f->n;
  double speed = 0.0;
  memset(f->wrenches, 0, n->joints * sizeof *f->wrenches);
  memset(f->J_of_path, 0, n->velocities * sizeof *f->J_of_path);
  f->length[path] = length_of(f, path);
  gather(f);
  for (int64_t c = 0; c < n->velocities; c++) speed += f->J_of_path[c] * f->v[c];
  for (int64_t i = n->couplings - 1; i >= 0; i--)
    f->J_of_path[f->couplings[i][1]] += f->slopes[i] * f->J_of_path[f->couplings[i][0]];
  f->speed[path] = speed;
  for (int64_t i = 0; i < n->independent; i++)
    f->columns[i * n->width + path] = -f->J_of_path[f->independent[i]];
}

EXPORT void state_paths(const Frame *f) {
  place_points(f);
  for (int64_t path = 0; path < f->n->paths; path++) measure(f, path);
}
