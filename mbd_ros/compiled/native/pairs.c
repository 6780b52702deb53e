/* Forces of pairs of points in different molecules: see methods/particles/pairs.py. */
#include <math.h>

#define EXPORT __attribute__((visibility("default")))

typedef struct {
  const double *edges, *charges, *powers; /* powers: four tables of types x types */
  const int *types;
  double cutoff;
  int n, kinds, is_periodic;
} Model;

/* Adds forces; pairs i < j, those of i from first[i] on. Returns the energy. */
EXPORT double add_pairs(const Model *model, const int *restrict first, const int *restrict second,
                        const double *restrict x, double *restrict force) {
  const double rc = model->cutoff, far = rc * rc, bend = 0.5 / (rc * rc * rc);
  const int kinds = model->kinds, table = kinds * kinds;
  double edge[3] = {0, 0, 0}, inverse_edge[3] = {0, 0, 0}, energy = 0.0;
  for (int k = 0; k < 3 && model->is_periodic; ++k) {
    edge[k] = model->edges[k];
    inverse_edge[k] = 1.0 / edge[k];
  }
  for (int i = 0; i < model->n; ++i) {
    const double xi = x[3 * i], yi = x[3 * i + 1], zi = x[3 * i + 2], qi = model->charges[i];
    const double *const row = model->powers + kinds * model->types[i];
    double fx = 0.0, fy = 0.0, fz = 0.0;
    for (int p = first[i]; p < first[i + 1]; ++p) {
      const int j = second[p];
      double dx = xi - x[3 * j], dy = yi - x[3 * j + 1], dz = zi - x[3 * j + 2];
      dx -= edge[0] * rint(dx * inverse_edge[0]);
      dy -= edge[1] * rint(dy * inverse_edge[1]);
      dz -= edge[2] * rint(dz * inverse_edge[2]);
      const double square = dx * dx + dy * dy + dz * dz;
      if (square >= far) continue;
      const double inverse = 1.0 / square, root = sqrt(inverse), q = qi * model->charges[j];
      energy += q * (root + bend * square - 1.5 / rc);
      double pull = q * (root * inverse - 2.0 * bend);
      const double *const of = row + model->types[j];
      if (of[0] != 0.0) {
        const double cube = inverse * inverse * inverse, r = square * root;
        energy += (of[0] * cube - of[table]) * cube - of[2 * table] - (r - rc) * of[3 * table];
        pull += (12.0 * of[0] * cube - 6.0 * of[table]) * cube * inverse + of[3 * table] * root;
      }
      fx += pull * dx, fy += pull * dy, fz += pull * dz;
      force[3 * j] -= pull * dx, force[3 * j + 1] -= pull * dy, force[3 * j + 2] -= pull * dz;
    }
    force[3 * i] += fx, force[3 * i + 1] += fy, force[3 * i + 2] += fz;
  }
  return energy;
}
