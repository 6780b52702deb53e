/* What paths ask of any surface. */

static int holds(const Surface *s, const double *p) {
  if (s->kind == CYLINDER) return p[0] * p[0] + p[1] * p[1] < s->size * s->size;
  if (s->kind == SPHERE) return dot3(p, p) < s->size * s->size;
  double u[3] = {p[0] / s->a[0], p[1] / s->a[1], p[2] / s->a[2]};
  return dot3(u, u) < 1.0;
}

static int meets(const Surface *s, const double *a, const double *b) {
  double middle[3], u[3], v[3];
  if (s->kind == CYLINDER) return cylinder_meets(s, a, b);
  if (s->kind == TORUS) return torus_meets(s, a, b);
  for (int i = 0; i < 3; i++) {
    double over = s->kind == SPHERE ? s->size : s->a[i];
    u[i] = a[i] / over;
    v[i] = b[i] / over;
  }
  int hits = crossing(u, v, 1.0, middle);
  return hits && !holds(s, a) && !holds(s, b) ? MUST_WRAP : NO_WRAP;
}

/* Where a path touches; returns the code, which may have become NO_WRAP. */
static int touch_surface(const Surface *s, const double *a, const double *b, int code, Arc *arc) {
  if (s->kind == CYLINDER) return cylinder_touch(s, a, b, code, arc);
  if (s->kind == SPHERE) return sphere_touch(s, a, b, code, arc);
  if (s->kind == TORUS) return torus_touch(s, a, b, code, arc);
  ellipsoid_touch(s, a, b, s->sign, arc);
  return code;
}

/* Completes an arc, roughly where that is enough; whether it can be followed. */
static int follow(const Surface *s, int is_rough, Arc *arc, Flow *flow) {
  if (s->kind >= ELLIPSOID) return curved_flow(s, is_rough, arc, flow);
  if (s->kind == CYLINDER) cylinder_flow(s, arc, flow);
  else sphere_flow(s, arc, flow);
  return 1;
}

static void normal_at(const Surface *s, const double *p, double *out) {
  if (s->kind == TORUS) {
    from_ring(s, p, out);
    return;
  }
  for (int i = 0; i < 3; i++) out[i] = s->kind == ELLIPSOID ? p[i] / (s->a[i] * s->a[i]) : p[i];
  if (s->kind == CYLINDER) out[2] = 0.0;
  unit3(out, out);
}

/* Change of the normal along a tangent. */
static void bend(const Surface *s, const double *p, const double *along, double *out) {
  if (s->kind == TORUS) {
    torus_bend(s, p, along, out);
    return;
  }
  if (s->kind != ELLIPSOID) {
    for (int i = 0; i < 3; i++) out[i] = along[i] / s->size;
    if (s->kind == CYLINDER) out[2] = 0.0;
    return;
  }
  double n[3];
  for (int i = 0; i < 3; i++) n[i] = p[i] / (s->a[i] * s->a[i]);
  double length = unit3(n, n);
  for (int i = 0; i < 3; i++) out[i] = along[i] / (s->a[i] * s->a[i] * length);
  double off = dot3(n, out);
  for (int i = 0; i < 3; i++) out[i] -= off * n[i];
}

/* A point on the surface near to one beside it. */
static void put_on(const Surface *s, double *p) {
  double flat = p[0] * p[0] + p[1] * p[1];
  if (s->kind == CYLINDER) {
    double scale = s->size / sqrt(flat);
    p[0] *= scale;
    p[1] *= scale;
    return;
  }
  if (s->kind == TORUS) {
    double n[3], out[3], middle[3];
    from_ring(s, p, n);
    ring_at(s, p, out, middle);
    for (int i = 0; i < 3; i++) p[i] = middle[i] + s->size * n[i];
    return;
  }
  double u[3];
  for (int i = 0; i < 3; i++) u[i] = p[i] / (s->kind == SPHERE ? s->size : s->a[i]);
  double scale = 1.0 / sqrt(dot3(u, u));
  for (int i = 0; i < 3; i++) p[i] *= scale;
}
