/* Kalman filters on one position signal: observer gains for the kernel, and the fixed-interval
 * smoother (Rauch, Tung, Striebel 1965). A sample that says nothing carries R < 0. Units: rad or m,
 * s.
 */
#include <math.h>
#include <stddef.h>

/* Gains of a double integrator driven by white acceleration of sa per sample. */
void zf_gains(int n, double T, const double *sa, const double *R, double *k1, double *k2, double *w)
{
    double p11 = 1e3 * (R[0] > 0 ? R[0] : 1e-6), p12 = 0, p22 = p11 * 1e3;
    for (int k = 0; k < n; k++) {
        double q = sa[k] * sa[k], q11 = q * T * T * T * T / 4, q12 = q * T * T * T / 2;
        if (R[k] > 0) {
            double S = p11 + R[k];
            k1[k] = p11 / S; k2[k] = p12 / S; w[k] = 1 / sqrt(S);
            double a = p11, b = p12;
            p11 -= k1[k] * a; p12 -= k1[k] * b; p22 -= k2[k] * b;
        } else { k1[k] = k2[k] = w[k] = 0; }
        p11 += 2 * T * p12 + T * T * p22 + q11;
        p12 += T * p22 + q12;
        p22 += q * T * T;
    }
}

/* States (q, qd, d): acceleration = a_in + d, d a random walk of sd per sqrt(second). work: 14 n
 * doubles. Returns -2 log-likelihood. out: 3 x n smoothed q, qd, d; var: 3 x n variances. half:
 * dead zone of the measurement. */
double zf_smooth(int n, double T, double sd, double sd0, const double *a_in, const double *m,
                 const double *half, const double *R, double q0, double v0, double *work,
                 double *out, double *var) {
    double x0 = q0, x1 = v0, x2 = 0, nll = 0;
    double P[6]; /* 00 01 02 11 12 22 */
    P[0] = 1e4 * (R[0] > 0 ? R[0] : 1e-6);
    P[1] = P[2] = P[4] = 0;
    P[3] = P[0] * 1e4 + 1e-3;
    P[5] = sd0 * sd0;
    /* filtered state and covariance; gains, S, e */
    double *xf = work, *Pf = work + 3 * (size_t)n, *gain = work + 9 * (size_t)n;
    double h = 0.5 * T * T;
    double q = sd * sd * T;
    for (int k = 0; k < n; k++) {
        if (R[k] > 0) {
            double e = m[k] - x0;
            e = e > half[k] ? e - half[k] : e < -half[k] ? e + half[k] : 0;
            double S = P[0] + R[k], g0 = P[0] / S, g1 = P[1] / S, g2 = P[2] / S;
            double *keep = gain + 5 * (size_t)k;
            keep[0] = g0; keep[1] = g1; keep[2] = g2; keep[3] = S; keep[4] = e;
            nll += log(S) + e * e / S;
            x0 += g0 * e; x1 += g1 * e; x2 += g2 * e;
            double a = P[0], b = P[1], c = P[2];
            P[0] -= g0 * a; P[1] -= g0 * b; P[2] -= g0 * c;
            P[3] -= g1 * b; P[4] -= g1 * c; P[5] -= g2 * c;
        }
        xf[3 * k] = x0; xf[3 * k + 1] = x1; xf[3 * k + 2] = x2;
        for (int i = 0; i < 6; i++) Pf[6 * (size_t)k + i] = P[i];
        double a = a_in[k];
        x0 += T * x1 + h * (x2 + a); x1 += T * (x2 + a);
        double A0 = P[0] + T * P[1] + h * P[2], A1 = P[1] + T * P[3] + h * P[4],
               A2 = P[2] + T * P[4] + h * P[5];
        double B1 = P[3] + T * P[4], B2 = P[4] + T * P[5];
        double n00 = A0 + T * A1 + h * A2, n01 = A1 + T * A2, n11 = B1 + T * B2;
        P[0] = n00; P[1] = n01; P[2] = A2; P[3] = n11; P[4] = B2; P[5] += q;
        P[3] += q * T * T / 3;
        P[4] += q * T / 2;
        P[0] += q * T * T * T * T / 20;
        P[1] += q * T * T * T / 8;
        P[2] += q * T * T / 6;
    }
    /* backward, in the adjoint form (Bryson and Frazier 1963): no matrix inverse */
    double l0 = 0, l1 = 0, l2 = 0, L00 = 0, L01 = 0, L02 = 0, L11 = 0, L12 = 0, L22 = 0;
    for (int k = n - 1; k >= 0; k--) {
        const double *p = Pf + 6 * (size_t)k;
        /* smoothed = xf - Pf * lambda_after, where lambda propagates back through F */
        if (k < n - 1) { /* lambda <- F' lambda, Lambda <- F' Lambda F */
            double t1 = l1 + T * l0, t2 = l2 + T * l1 + h * l0;
            l1 = t1; l2 = t2;
            double a0 = L00, a1 = L01 + T * L00, a2 = L02 + T * L01 + h * L00;
            double b1 = L11 + T * L01, b2 = L12 + T * L11 + h * L01;
            double c2 = L22 + T * L12 + h * L02;
            L00 = a0; L01 = a1; L02 = a2;
            L11 = b1 + T * a1; L12 = b2 + T * a2;
            L22 = c2 + T * b2 + h * a2;
        }
        double s0 = p[0] * l0 + p[1] * l1 + p[2] * l2, s1 = p[1] * l0 + p[3] * l1 + p[4] * l2,
               s2 = p[2] * l0 + p[4] * l1 + p[5] * l2;
        out[k] = xf[3 * k] - s0;
        out[n + k] = xf[3 * k + 1] - s1;
        out[2 * (size_t)n + k] = xf[3 * k + 2] - s2;
        if (var) {
            double u[3][3] = { { p[0], p[1], p[2] }, { p[1], p[3], p[4] }, { p[2], p[4], p[5] } };
            double L[3][3] = { { L00, L01, L02 }, { L01, L11, L12 }, { L02, L12, L22 } };
            for (int i = 0; i < 3; i++) {
                double acc = 0;
                for (int a = 0; a < 3; a++)
                    for (int b = 0; b < 3; b++)
                        acc += u[i][a] * L[a][b] * u[b][i];
                double vv = u[i][i] - acc;
                var[(size_t)i * n + k] = vv > 0 ? vv : 0;
            }
        }
        if (R[k] > 0) { /* through the measurement: lambda <- (I - K H)' lambda - H' e / S */
            const double *keep = gain + 5 * (size_t)k;
            double g0 = keep[0], g1 = keep[1], g2 = keep[2], S = keep[3], e = keep[4];
            double dot = g0 * l0 + g1 * l1 + g2 * l2;
            double c0 = g0 * L00 + g1 * L01 + g2 * L02, c1 = g0 * L01 + g1 * L11 + g2 * L12,
                   c2 = g0 * L02 + g1 * L12 + g2 * L22;
            double gg = g0 * c0 + g1 * c1 + g2 * c2;
            l0 = l0 - dot - e / S;
            L00 = L00 - 2 * c0 + gg + 1 / S;
            L01 -= c1; L02 -= c2;
        }
    }
    return nll;
}

/* What hangs on a joint and swings when it is accelerated, a[n]: place[k] = first place[k-1] +
 * second place[k-2] + T^2 a[k-1]. */
void zf_swing(int n, double T, double first, double second, const double *a, double *place)
{
    for (int k = 0; k < n; k++)
        place[k] = (k > 0 ? first * place[k - 1] + T * T * a[k - 1] : 0.0) +
                   (k > 1 ? second * place[k - 2] : 0.0);
}
