/* wam_gravity.h: the torque that holds the Barrett WAM against its weight, from masses and centres
 * of mass (Barrett AC-02).
 *
 *     g_k = axis_k · Σ_{i >= k} (com_i - origin_k) x m_i (0, 0, 9.81)
 *
 * Standard Denavit-Hartenberg frames; the sum is carried from the base outwards in two running
 * totals.
 */
#ifndef ZENDSP_WAM_GRAVITY_H
#define ZENDSP_WAM_GRAVITY_H

#include <math.h> /* sin, cos */

/* a, d (m), cos and sin of alpha, mass (kg), centre of mass in the link's frame (m) */
static const struct wam_link {
    double a, d, ca, sa, mass, com[3];
} wam_links[7] = {
    {0.0, 0.0, 0.0, -1.0, 10.768, {-0.0044342, 0.12189, -0.00066489}},
    {0.0, 0.0, 0.0, 1.0, 3.8749, {-0.0023698, 0.031056, 0.015421}},
    {0.045, 0.55, 0.0, -1.0, 1.8023, {-0.038259, 0.20751, 3.309e-05}},
    {-0.045, 0.0, 0.0, 1.0, 2.4007, {0.0049851, -0.00022942, 0.13272}},
    {0.0, 0.3, 0.0, -1.0, 0.12376, {8.921e-05, 0.0051122, 0.0043582}},
    {0.0, 0.0, 0.0, 1.0, 0.41797, {0.00012262, -0.017032, 0.024683}},
    {0.0, 0.06, 1.0, 0.0, 0.068648, {-7.974e-05, 0.00016313, -0.0032355}},
};

static inline void WamGravity(const double *angle, double *torque) {
    double R[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, o[3] = {0, 0, 0};
    /* gravity is along z: only x and y count */
    double axis[7][2], origin[7][2], moment[7][2], mass[7];
    for (int k = 0; k < 7; k++) {
        const struct wam_link *l = &wam_links[k];
        const double c = cos(angle[k]), s = sin(angle[k]);
        const double turn[3][3] = {
            {c, -s * l->ca, s * l->sa}, {s, c * l->ca, -c * l->sa}, {0.0, l->sa, l->ca}};
        const double way[3] = {l->a * c, l->a * s, l->d};
        double next[3][3];
        for (int i = 0; i < 2; i++) {
            axis[k][i] = R[i][2];
            origin[k][i] = o[i];
        }
        for (int i = 0; i < 3; i++) {
            o[i] += R[i][0] * way[0] + R[i][1] * way[1] + R[i][2] * way[2];
            for (int j = 0; j < 3; j++)
                next[i][j] = R[i][0] * turn[0][j] + R[i][1] * turn[1][j] + R[i][2] * turn[2][j];
        }
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                R[i][j] = next[i][j];
        mass[k] = l->mass;
        for (int i = 0; i < 2; i++)
            moment[k][i] =
                l->mass * (o[i] + R[i][0] * l->com[0] + R[i][1] * l->com[1] + R[i][2] * l->com[2]);
    }
    double m = 0.0, x = 0.0, y = 0.0; /* of all links from k on */
    for (int k = 6; k >= 0; k--) {
        m += mass[k];
        x += moment[k][0];
        y += moment[k][1];
        torque[k] =
            9.81 * (axis[k][0] * (y - m * origin[k][1]) - axis[k][1] * (x - m * origin[k][0]));
    }
}

#endif
