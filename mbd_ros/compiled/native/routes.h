/* Which surfaces a path wraps over, and where: as core/kinematics/paths/wrapped_path.py decides, from the
 * points and poses of now alone.
 */
#define MOST_SOLVED 48  /* lines over surfaces that one search may look at */
#define ROUNDS 8

/* A path as tables have it. */
typedef struct {
  int points, wraps, first;  /* of its wraps in the tables */
} WrapPath;

typedef struct {
  int surface, first, last;  /* points between which it acts */
} WrapReach;

/* The wraps on every line between points, in order. */
typedef struct {
  signed char count[MOST_LINES], wraps[MOST_LINES][MOST_WRAPS];
} Held;

typedef struct {
  int line, count;
  signed char wraps[MOST_WRAPS];
  Arc arcs[MOST_WRAPS];
  double ends[MOST_WRAPS][2][3];
} Solved;

typedef struct {
  const WrapPath *path;
  const WrapReach *reaches;
  const double *points;
  Placed places[MOST_WRAPS];
  int count;
  Solved solved[MOST_SOLVED];
} Router;

static Solved *known(Router *r, int line, int count, const signed char *wraps) {
  for (int i = 0; i < r->count; i++) {
    Solved *one = r->solved + i;
    if (one->line == line && one->count == count && !memcmp(one->wraps, wraps, count)) return one;
  }
  return 0;
}

static Solved *geodesics_of(Router *r, const Held *held, int line) {
  return known(r, line, held->count[line], held->wraps[line]);
}

/* Solves a line over surfaces from a guess; whether there is a path. */
static int store(Router *r, int line, int count, const signed char *wraps, Arc *arcs, int is_done) {
  Placed over[MOST_WRAPS];
  const double *a = r->points + 3 * line;
  Solved *one = known(r, line, count, wraps);
  if (!one && r->count == MOST_SOLVED) return 0;
  for (int i = 0; i < count; i++) over[i] = r->places[wraps[i]];
  if (!is_done && !solved(a, a + 3, count, over, arcs)) return 0;
  if (!one) one = r->solved + r->count++;
  one->line = line;
  one->count = count;
  memcpy(one->wraps, wraps, count);
  memcpy(one->arcs, arcs, count * sizeof *arcs);
  for (int i = 0; i < count; i++) {
    outwards(over[i].place, arcs[i].start, one->ends[i][0]);
    outwards(over[i].place, arcs[i].end, one->ends[i][1]);
  }
  return 1;
}

/* Line, and place in it, of a wrap that is off the path; -1 where it stays off. */
static int chosen_place(Router *r, const Held *held, int which, int *place, Arc *guess) {
  const WrapReach *reach = r->reaches + which;
  const Placed *placed = r->places + which;
  const Surface *s = placed->surface;
  double least = INFINITY;
  int chosen = -1;
  for (int line = reach->first; line < reach->last && least >= 0.0; line++) {
    const Solved *on = held->count[line] ? geodesics_of(r, held, line) : 0;
    const double *from = r->points + 3 * line;
    for (int i = 0, k = 0; i <= held->count[line] && least >= 0.0; i++) {
      int is_end = i == held->count[line];
      if (!is_end && held->wraps[line][i] == which) continue;
      const double *to = is_end ? r->points + 3 * (line + 1) : on->ends[i][0];
      double a[3], b[3], cost = -1.0;
      Arc arc;
      inwards(placed->place, from, a);
      inwards(placed->place, to, b);
      int code = meets(s, a, b);
      if (code != NO_WRAP) code = touch_surface(s, a, b, code, &arc);
      if (code == MAY_WRAP) {
        Line straight, first;
        line_between(a, b, &straight);
        line_between(a, arc.start, &first);
        cost = arc.length + first.length - straight.length;
      }
      if (code != NO_WRAP && cost < least) {
        least = cost;
        chosen = line;
        *place = k;
        *guess = arc;
      }
      if (!is_end) from = on->ends[i][1];
      k++;
    }
  }
  return chosen;
}

/* Solves a line with a wrap more or less. */
static int press(Router *r, int line, const Held *before, const Held *now, int which,
                 const Arc *guess) {
  int count = now->count[line];
  const signed char *wraps = now->wraps[line];
  if (!count || known(r, line, count, wraps)) return 1;
  const Solved *was = before->count[line] ? geodesics_of(r, before, line) : 0;
  Arc arcs[MOST_WRAPS];
  for (int i = 0; i < count; i++) {
    if (guess && wraps[i] == which) arcs[i] = *guess;
    for (int j = 0; was && j < was->count; j++)
      if (was->wraps[j] == wraps[i] && !(guess && wraps[i] == which)) arcs[i] = was->arcs[j];
  }
  int is_done = guess && count == 1 && r->places[which].surface->kind < ELLIPSOID;
  return store(r, line, count, wraps, arcs, is_done);
}

/* Leaves out wraps that the path would leave: their geodesics have negative lengths. */
static int lift_off(Router *r, Held *held, int line) {
  while (held->count[line]) {
    const Solved *on = geodesics_of(r, held, line);
    signed char left[MOST_WRAPS] = {0};
    Arc arcs[MOST_WRAPS];
    int count = 0;
    for (int i = 0; i < on->count; i++)
      if (!(on->arcs[i].length < 0.0)) {
        arcs[count] = on->arcs[i];
        left[count++] = on->wraps[i];
      }
    if (count == on->count) return 1;
    if (count && !store(r, line, count, left, arcs, 0)) return 0;
    held->count[line] = count;
    memcpy(held->wraps[line], left, sizeof left);
  }
  return 1;
}

/* Takes a wrap off and puts it where it belongs; whether all lines have a path. */
static int try_wrap(Router *r, Held *held, int which) {
  Held now = {{0}};
  Arc guess;
  int lines = r->path->points - 1, place = 0;
  int chosen = chosen_place(r, held, which, &place, &guess);
  for (int line = 0; line < lines; line++) {
    int count = 0;
    for (int i = 0; i < held->count[line]; i++) {
      if (held->wraps[line][i] == which) continue;
      if (line == chosen && count == place) now.wraps[line][count++] = which;
      now.wraps[line][count++] = held->wraps[line][i];
    }
    if (line == chosen && count == place) now.wraps[line][count++] = which;
    now.count[line] = count;
  }
  if (chosen >= 0) {
    Flow flow;
    if (!follow(r->places[which].surface, 1, &guess, &flow)) return 0;
  }
  int changed[MOST_LINES];
  for (int line = 0; line < lines; line++) {
    changed[line] = held->count[line] != now.count[line] ||
                    memcmp(held->wraps[line], now.wraps[line], MOST_WRAPS);
    if (changed[line] && !press(r, line, held, &now, which, line == chosen ? &guess : 0)) return 0;
  }
  for (int line = 0; line < lines; line++)
    if (changed[line] && !lift_off(r, &now, line)) return 0;
  *held = now;
  return 1;
}

static int same(const Held *a, const Held *b) { return !memcmp(a, b, sizeof *a); }

static int wraps_on(const Held *held) {
  int count = 0;
  for (int line = 0; line < MOST_LINES; line++) count += held->count[line];
  return count;
}

/* Tries wraps in turn until a whole round changes nothing, or has been there before. */
static int settle_route(Router *r, Held *held) {
  Held past[ROUNDS * MOST_WRAPS + 1];
  int count = r->path->wraps, trial = 0;
  memset(held, 0, sizeof *held);
  for (;; trial++) {
    int is_calm = trial >= count, is_again = 0;
    past[trial] = *held;
    for (int i = 1; is_calm && i <= count; i++) is_calm = same(past + trial - i, held);
    if (is_calm || (count == 1 && trial)) return 1;
    for (int i = trial - count; trial > count && i >= 0; i -= count)
      is_again |= same(past + i, held);
    if (is_again || trial == ROUNDS * count) break;
    if (!try_wrap(r, held, trial % count)) return 0;
  }
  *held = past[trial - count + 1];
  for (int i = trial - count + 2; i <= trial; i++)
    if (wraps_on(past + i) > wraps_on(held)) *held = past[i];
  return 1;
}
