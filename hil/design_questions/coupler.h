/* A coupler for a virtual wall, made by hilrig.
 *
 * Safe for every passive hand and every passive wall at total delays of $delays samples of $period s,
 * where device and hand together damp at least $damping N s/m.
 * It leaves a rigid wall a static stiffness of $stiffness N/m.
 *
 * Call hil_wall_force once every period with the measured position in m (positive inside the wall); send -force to the motor.
 * Use one struct hil_wall per wall, all zero at the start.
 */
#ifndef HIL_COUPLER_H
#define HIL_COUPLER_H

#define HIL_COUPLER_TAPS $count
#define HIL_COUPLER_PERIOD_S $period
#define HIL_COUPLER_DAMPING_N_S_PER_M $damping

static const double hil_coupler_taps_m_per_n[HIL_COUPLER_TAPS] = {
$taps
};

struct hil_wall {
    double force_n[HIL_COUPLER_TAPS]; /* past forces, newest first */
    double avatar_m;                  /* where the avatar was */
};

/* Force of a wall of stiffness k (N/m) and damping b (N s/m) on the avatar, N, at least 0. */
static inline double hil_wall_force(struct hil_wall *w, double position_m, double k, double b)
{
    const double c0 = hil_coupler_taps_m_per_n[0], rate = b / HIL_COUPLER_PERIOD_S;
    double past = 0.0, free_m, x, f;
    int i;
    for (i = 1; i < HIL_COUPLER_TAPS; ++i) past += hil_coupler_taps_m_per_n[i] * w->force_n[i - 1];
    free_m = position_m - past;
    if (free_m < 0.0) {
        f = 0.0;
        x = free_m;
    } else if (-c0 * rate * w->avatar_m >= free_m && w->avatar_m < 0.0) {
        f = free_m / c0; /* the damper alone stops the avatar at the surface */
        x = 0.0;
    } else {
        x = (free_m + c0 * rate * w->avatar_m) / (1.0 + c0 * (k + rate));
        f = k * x + rate * (x - w->avatar_m);
        if (f <= 0.0) {
            f = 0.0;
            x = free_m;
        }
    }
    for (i = HIL_COUPLER_TAPS - 1; i > 0; --i) w->force_n[i] = w->force_n[i - 1];
    w->force_n[0] = f;
    w->avatar_m = x;
    return f;
}

#endif
