// MuJoCo's C library behind the line protocol of `cargo xtask peers` (xtask/src/peers.rs).
//
// Simulates the dimensionless display, the paper's (6): mu xi'' + beta xi' + sigma sgn(xi') = phi, with
// phi = -(floor(xi) + 1/2) held for one sample. A slide joint has the mass mu, the damping beta and the
// friction loss sigma; the force comes through qfrc_applied. A sample is `steps` steps of 1/steps.
//
// A request is one line: run SETTING MU V0 SAMPLES BETA,SIGMA ...
// An answer is one line: done SECONDS SAMPLES CLASSES, the samples being those really simulated, and the
// classes a letter for each display: r rest, c limit cycle, u unstable; or: error TEXT.
// A setting is a list of words joined by commas, see `set`.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include <mujoco/mujoco.h>

// What a setting chooses beside the model's options.
typedef struct {
  int steps;      // steps per sample
  int parts;      // 1: mj_forwardSkip and the integrator in place of mj_step: what depends on position, here
                  // nothing, is computed once per display
  int trapezoid;  // 1: the position from the mean of the velocities before and after the step, ours
  int by_hand;    // 1: friction as a force -sigma sgn(v) of ours, MuJoCo's constraint solver off
} Way;

// The window rule of plant-sim/src/outcome.rs.
enum { WINDOW = 2000 };
static const double DIVERGED_COUNTS = 1e9, CONVERGED_SPEED = 0.01, GROWTH = 1.02;

static void fail(const char* text) {
  printf("error %s\n", text);
  exit(1);
}

static void on_error(const char* text) { fail(text); }
static void on_warning(const char* text) { (void)text; }

static mjModel* compile(void) {
  const char* xml =
      "<mujoco><option gravity='0 0 0'/><worldbody><body>"
      "<inertial pos='0 0 0' mass='1' diaginertia='1 1 1'/>"
      "<joint type='slide' axis='1 0 0' damping='1' frictionloss='1'/>"
      "</body></worldbody></mujoco>";
  char error[1000] = "";
  mjSpec* spec = mj_parseXMLString(xml, NULL, error, sizeof error);
  mjModel* model = spec ? mj_compile(spec, NULL) : NULL;
  if (!model) fail(error);
  mj_deleteSpec(spec);
  return model;
}

// Applies a setting to a fresh model; false if it names something unknown.
static int set(mjModel* m, Way* way, char* setting) {
  double hard = 0;
  char* rest;
  for (char* word = strtok_r(setting, ",", &rest); word; word = strtok_r(NULL, ",", &rest)) {
    double number = 0;
    char* equals = strchr(word, '=');
    if (equals) {
      *equals = 0;
      number = atof(equals + 1);
    }
    if (!strcmp(word, "steps")) way->steps = (int)number;
    else if (!strcmp(word, "euler")) m->opt.integrator = mjINT_EULER;
    else if (!strcmp(word, "rk4")) m->opt.integrator = mjINT_RK4;
    else if (!strcmp(word, "implicit")) m->opt.integrator = mjINT_IMPLICIT;
    else if (!strcmp(word, "implicitfast")) m->opt.integrator = mjINT_IMPLICITFAST;
    else if (!strcmp(word, "discrete")) m->opt.integrator = mjINT_DISCRETE;
    else if (!strcmp(word, "explicit")) m->opt.disableflags |= mjDSBL_EULERDAMP;
    else if (!strcmp(word, "pgs")) m->opt.solver = mjSOL_PGS;
    else if (!strcmp(word, "hard")) hard = number;
    else if (!strcmp(word, "lean"))
      m->opt.disableflags |= mjDSBL_EQUALITY | mjDSBL_LIMIT | mjDSBL_CONTACT | mjDSBL_SPRING | mjDSBL_GRAVITY |
                             mjDSBL_CLAMPCTRL | mjDSBL_ACTUATION | mjDSBL_SENSOR | mjDSBL_ISLAND |
                             mjDSBL_AUTORESET | mjDSBL_WARMSTART;
    else if (!strcmp(word, "parts")) way->parts = 1;
    else if (!strcmp(word, "trapezoid")) way->trapezoid = 1;
    else if (!strcmp(word, "by-hand")) way->by_hand = 1, m->opt.disableflags |= mjDSBL_CONSTRAINT;
    else return 0;
  }
  if (way->steps < 1) return 0;
  m->opt.timestep = 1.0 / way->steps;
  if (hard > 0) {
    // Friction loss is a soft constraint that creeps. As hard as it gets: the largest impedance, and a damping
    // of the velocity within 1/hard steps, which the positive form of solref does not allow (refsafe).
    m->dof_solimp[0] = m->dof_solimp[1] = mjMAXIMP;
    m->dof_solref[0] = -1e-9;
    m->dof_solref[1] = -hard * way->steps * mjMAXIMP;
  }
  return 1;
}

// One display; its class, and the samples run added to *run.
static char display(mjModel* m, mjData* d, const Way* way, double beta, double sigma, double v0, long samples,
                    long* run) {
  m->dof_damping[0] = beta;
  m->dof_frictionloss[0] = way->by_hand ? 0 : sigma;
  mj_resetData(m, d);
  d->qvel[0] = v0;
  if (way->parts) mj_fwdPosition(m, d);
  const long first[3] = {0, samples / 2, samples - WINDOW + 1};
  const long last[3] = {WINDOW, samples / 2 + WINDOW, samples};
  double peak[3] = {0, 0, 0};
  for (long sample = 0;; sample++) {
    const double x = d->qpos[0], v = d->qvel[0], speed = fabs(v);
    for (int w = 0; w < 3; w++)
      if (first[w] <= sample && sample <= last[w] && speed > peak[w]) peak[w] = speed;
    const double phi = -(floor(x) + 0.5);
    if (v == 0 && fabs(phi) <= sigma) return 'r';
    if (!(fabs(x) <= DIVERGED_COUNTS)) return 'u';
    if (sample == samples) break;
    for (int step = 0; step < way->steps; step++) {
      const double before = d->qpos[0], velocity_before = d->qvel[0];
      double force = phi;
      if (way->by_hand)
        force -= velocity_before != 0 ? copysign(sigma, velocity_before) : fmin(fmax(phi, -sigma), sigma);
      d->qfrc_applied[0] = force;
      if (way->parts) {
        mj_forwardSkip(m, d, mjSTAGE_POS, 1);
        if (m->opt.integrator == mjINT_EULER) mj_Euler(m, d);
        else mj_implicit(m, d);
      } else {
        mj_step(m, d);
      }
      if (way->trapezoid) d->qpos[0] = before + m->opt.timestep * (velocity_before + d->qvel[0]) / 2;
    }
    ++*run;
  }
  if (peak[2] > GROWTH * peak[1] && peak[2] > GROWTH * peak[0]) return 'u';
  return peak[2] < CONVERGED_SPEED ? 'r' : 'c';
}

// Time that this process has had on a processor, s: what else runs there does not count.
static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(void) {
  mju_user_error = on_error;
  mju_user_warning = on_warning;
  setvbuf(stdout, NULL, _IOLBF, 0);
  printf("ready MuJoCo %s\n", mj_versionString());
  char* line = NULL;
  size_t room = 0;
  while (getline(&line, &room, stdin) > 0) {
    char* rest;
    char* word = strtok_r(line, " \n", &rest);
    if (!word || strcmp(word, "run")) fail("a request that is none");
    char* setting = strtok_r(NULL, " \n", &rest);
    char* mu = strtok_r(NULL, " \n", &rest);
    char* v0 = strtok_r(NULL, " \n", &rest);
    char* samples = strtok_r(NULL, " \n", &rest);
    if (!samples) fail("a request that is too short");
    mjModel* m = compile();  // not timed, like what follows
    m->body_mass[1] = atof(mu);
    Way way = {0};
    if (!set(m, &way, setting)) fail("a setting that is none");
    mjData* d = mj_makeData(m);
    mj_setConst(m, d);
    char classes[100000];
    long count = 0, run = 0;
    const double start = now();
    while ((word = strtok_r(NULL, " \n", &rest)) && count < (long)sizeof classes - 1) {
      double beta, sigma;
      if (sscanf(word, "%lf,%lf", &beta, &sigma) != 2) fail("a display that is none");
      classes[count++] = display(m, d, &way, beta, sigma, atof(v0), atol(samples), &run);
    }
    classes[count] = 0;
    printf("done %.9f %ld %s\n", now() - start, run, classes);
    mj_deleteData(d);
    mj_deleteModel(m);
  }
  return 0;
}
