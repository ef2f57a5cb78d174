#include "server/optical/track/moving_point.h"

#include <cmath>

namespace secondskin::server {
namespace {

Eigen::Matrix3d symmetric(const Eigen::Matrix3d& m) noexcept { return 0.5 * (m + m.transpose()); }

}  // namespace

MovingPoint MovingPoint::at(const Eigen::Vector3d& p, double sigma_p, double sigma_v,
                            double sigma_a) noexcept {
  const Eigen::Matrix3d I = Eigen::Matrix3d::Identity(), O = Eigen::Matrix3d::Zero();
  return {p,
          Eigen::Vector3d::Zero(),
          Eigen::Vector3d::Zero(),
          sigma_p * sigma_p * I,
          O,
          O,
          sigma_v * sigma_v * I,
          O,
          sigma_a * sigma_a * I};
}

Eigen::Matrix<double, 9, 1> MovingPoint::state() const noexcept {
  Eigen::Matrix<double, 9, 1> x;
  x << p, v, a;
  return x;
}

Eigen::Matrix<double, 9, 9> MovingPoint::covariance() const noexcept {
  Eigen::Matrix<double, 9, 9> P;
  P << P_pp, P_pv, P_pa, P_pv.transpose(), P_vv, P_va, P_pa.transpose(), P_va.transpose(), P_aa;
  return P;
}

void predict(MovingPoint& s, const Manoeuvre& manoeuvre, double dt) noexcept {
  // F = [I dt c; 0 I d; 0 0 e] in blocks of I.
  const double T = manoeuvre.memory;
  const double e = std::exp(-dt / T);
  const double d = -T * std::expm1(-dt / T);
  const double c = T * (dt - d);
  s.p += dt * s.v + c * s.a;
  s.v += d * s.a;
  s.a *= e;

  const double q = manoeuvre.jerk * manoeuvre.jerk;
  const double dt2 = dt * dt, dt3 = dt2 * dt;
  const Eigen::Matrix3d pa = s.P_pa + dt * s.P_va + c * s.P_aa;  // rows p of F P
  const Eigen::Matrix3d pv = s.P_pv + dt * s.P_vv + c * s.P_va.transpose();
  const Eigen::Matrix3d va = s.P_va + d * s.P_aa;  // row v of F P
  const Eigen::Matrix3d pp = s.P_pp + dt * s.P_pv.transpose() + c * s.P_pa.transpose();
  s.P_pp = symmetric(pp + dt * pv + c * pa);
  s.P_vv = symmetric(s.P_vv + d * (s.P_va.transpose() + va));
  s.P_pv = pv + d * pa;
  s.P_pa = e * pa;
  s.P_va = e * va;
  s.P_aa = e * e * symmetric(s.P_aa);
  s.P_pp.diagonal().array() += q * dt3 * dt2 / 20.0;
  s.P_pv.diagonal().array() += q * dt2 * dt2 / 8.0;
  s.P_pa.diagonal().array() += q * dt3 / 6.0;
  s.P_vv.diagonal().array() += q * dt3 / 3.0;
  s.P_va.diagonal().array() += q * dt2 / 2.0;
  s.P_aa.diagonal().array() += q * dt;
}

Innovation innovation(const MovingPoint& s, const Eigen::RowVector3d& gradient, double residual,
                      double variance) noexcept {
  const Eigen::Vector3d g = gradient.transpose();
  return {residual, g.dot(s.P_pp * g) + variance, g};
}

void correct(MovingPoint& s, const Innovation& i) noexcept {
  const Eigen::Vector3d Hp = s.P_pp * i.g;
  const Eigen::Vector3d Hv = s.P_pv.transpose() * i.g;
  const Eigen::Vector3d Ha = s.P_pa.transpose() * i.g;
  const Eigen::Vector3d Kp = Hp / i.S, Kv = Hv / i.S, Ka = Ha / i.S;
  s.p += Kp * i.nu;
  s.v += Kv * i.nu;
  s.a += Ka * i.nu;
  s.P_pp -= Kp * Hp.transpose();
  s.P_pv -= Kp * Hv.transpose();
  s.P_pa -= Kp * Ha.transpose();
  s.P_vv -= Kv * Hv.transpose();
  s.P_va -= Kv * Ha.transpose();
  s.P_aa -= Ka * Ha.transpose();
}

MovingPoint blend(const MovingPoint& a, const MovingPoint& b, double w) noexcept {
  const double u = 1.0 - w,
               s = w * u;  // w (a - m)(a - m)' + u (b - m)(b - m)' = w u (a - b)(a - b)'
  const Eigen::Vector3d dp = a.p - b.p, dv = a.v - b.v, da = a.a - b.a;
  return {w * a.p + u * b.p,
          w * a.v + u * b.v,
          w * a.a + u * b.a,
          w * a.P_pp + u * b.P_pp + s * dp * dp.transpose(),
          w * a.P_pv + u * b.P_pv + s * dp * dv.transpose(),
          w * a.P_pa + u * b.P_pa + s * dp * da.transpose(),
          w * a.P_vv + u * b.P_vv + s * dv * dv.transpose(),
          w * a.P_va + u * b.P_va + s * dv * da.transpose(),
          w * a.P_aa + u * b.P_aa + s * da * da.transpose()};
}

}  // namespace secondskin::server
