/* ---- Trial of other settings ------------------------------------------------------------------ */

/* What became of the last trial. */
enum {
    NO_TRIAL,
    TRIED,         /* it drives the axis */
    DONE,          /* there and back, each with its rest */
    REFUSED,       /* the axis was not at rest, or at fault */
    LET_GO,        /* its operator has ended it */
    SILENT,        /* its operator gave no sign of life */
    UNSTABLE,      /* the loop swings */
    CHATTERS,      /* the duty does */
    AT_LIMIT,      /* the drive was at its limit */
    TOO_FAR_OFF,   /* the following error is too large */
    OUT_OF_TRAVEL, /* the axis is */
    TOO_LONG,      /* it was not there and back in time */
    GIVEN_UP       /* the axis is, with a fault or without enable */
};

typedef struct {
    {{ name }}_state controller;
    {{ name }}_set set;
    int state, ends, sign, silent, periods, at_limit, still, moved, rests;
    double gain, error_max, low, high;  /* as it was begun [-, m, m, m] */
    double held, error, mean, ripple;   /* duty at rest [-]; error [m]; duty, its mean and ripple */
} trial;

/* Have the trial drive an axis at rest that a duty holds, from the next period on. */
static void trial_begin(trial *t, double position, double duty)
{
    t->controller.set = &t->set;
    {{ name }}_reset_at(&t->controller, position, duty / t->gain);
    t->silent = t->periods = t->at_limit = t->still = t->moved = t->rests = 0;
    t->held = t->mean = duty;
    t->error = t->ripple = 0.0;
    t->state = t->ends = TRIED;
}

/* Say what a trial that drives the axis becomes in this period. */
static int trial_judge(trial *t, double error, double position, double duty, int moves)
{
    int full = fabs(duty) >= DUTY_MAX * (t->gain < 1.0 ? t->gain : 1.0);
    double off;

    if (isfinite(position))
        t->error = error;
    t->periods++;
    t->moved = t->moved || moves;
    t->still = moves ? 0 : t->still + 1;
    t->rests += t->moved && t->still == {{ rest_periods }};
    t->at_limit = full ? t->at_limit + 1 : 0;
    t->mean += (duty - t->mean) * {{ fast }};
    off = duty - t->mean;
    t->ripple += (off * off - t->ripple) * {{ over }};
    if (t->silent >= {{ silence }})
        return SILENT;
    if (t->controller.fault == {{ name }}_SWINGS || t->controller.share < 1.0 ||
        t->controller.grows || t->controller.alike >= SWING_LASTS)
        return UNSTABLE;
    if (sqrt(t->ripple) > {{ chatter }})
        return CHATTERS;
    if (t->at_limit >= {{ at_limit }})
        return AT_LIMIT;
    if (fabs(t->error) > t->error_max)
        return TOO_FAR_OFF;
    if (position < t->low || position > t->high)
        return OUT_OF_TRAVEL;
    if (t->periods > {{ longest }})
        return TOO_LONG;
    return t->rests >= 2 ? DONE : TRIED;
}
