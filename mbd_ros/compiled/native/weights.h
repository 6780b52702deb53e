/* Sums of rows: out = factor sum_j value_j rows[column_j], all of width NR or NW. */
#define CHUNK 4
typedef double Chunk __attribute__((vector_size(8 * CHUNK), aligned(8)));

#define SUM(name, width)                                                                      \
  static inline __attribute__((always_inline)) void name(Weights by, long row, double factor, \
                                                         const real (*rows)[width],           \
                                                         real *restrict out) {                \
    long first = by.begin[row], last = by.begin[row + 1], k = 0;                              \
    for (; LANES == 1 && k + CHUNK <= (width); k += CHUNK) {                                  \
      Chunk sum = {0.0};                                                                      \
      for (long j = first; j < last; j++) {                                                   \
        Chunk rate;                                                                           \
        memcpy(&rate, &rows[by.column[j]][k], sizeof rate);                                   \
        sum += by.value[j] * rate;                                                            \
      }                                                                                       \
      sum *= factor;                                                                          \
      memcpy(out + k, &sum, sizeof sum);                                                      \
    }                                                                                         \
    for (; k < (width); k++) {                                                                \
      real sum = R(0.0);                                                                      \
      for (long j = first; j < last; j++) sum += by.value[j] * rows[by.column[j]][k];         \
      out[k] = factor * sum;                                                                  \
    }                                                                                         \
  }

SUM(sum_rates, NR)
SUM(sum_history, NW)

/* out = factor_0 (rows_0 + factor_1 (rows_1 + ..)), of width NR. */
static inline void sum_nested(long count, const double *factors, const real (*rows)[NR],
                              real *restrict out) {
  long k = 0;
  for (; LANES == 1 && k + CHUNK <= NR; k += CHUNK) {
    Chunk sum = {0.0};
    for (long i = count - 1; i >= 0; i--) {
      Chunk row;
      memcpy(&row, &rows[i][k], sizeof row);
      sum = factors[i] * (sum + row);
    }
    memcpy(out + k, &sum, sizeof sum);
  }
  for (; k < NR; k++) {
    real sum = R(0.0);
    for (long i = count - 1; i >= 0; i--) sum = factors[i] * (sum + rows[i][k]);
    out[k] = sum;
  }
}
