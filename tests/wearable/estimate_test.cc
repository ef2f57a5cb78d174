#include <gtest/gtest.h>

#include <functional>

#include "motion/rotation.h"
#include "tests/wearable/drawn_body.h"

namespace secondskin::server {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

class Estimate : public testing::Test {
 protected:
  const Skeleton skeleton = canonical_skeleton();
  const Garment garment = practical_garment();
  const BodyModel body{skeleton, garment, places(skeleton, garment)};
  const BodyLayout& layout = body.layout;
  const int n = layout.size();

  BodyState rest() const {
    BodyState state;
    state.groups.resize(static_cast<std::size_t>(layout.groups));
    state.boards.resize(garment.boards.size());
    return state;
  }
  std::span<double> column(VectorXd& v) const { return {v.data(), static_cast<std::size_t>(n)}; }

  // d y / d error by central differences, times -1: what H should be.
  MatrixXd numerical(const BodyState& state,
                     const std::function<void(const BodyState&, ObservationSet&)>& observe) {
    ObservationSet set(layout, 64);
    MatrixXd H;
    for (int c = 0; c < n; ++c) {
      constexpr double kStep = 1e-5;
      VectorXd y[2];
      for (const int side : {0, 1}) {
        VectorXd error = VectorXd::Zero(n);
        error[c] = side == 0 ? -kStep : kStep;
        BodyState moved = state;
        correct(layout, column(error), moved);
        set.clear();
        observe(moved, set);
        y[side] = Eigen::Map<const VectorXd>(set.y.data(), set.size());
      }
      if (c == 0) H.resize(y[0].size(), n);
      H.col(c) = (y[0] - y[1]) / (2.0 * kStep);
    }
    return H;
  }

  void expect_jacobian(const BodyState& state,
                       const std::function<void(const BodyState&, ObservationSet&)>& observe,
                       double tolerance = 1e-6) {
    ObservationSet set(layout, 64);
    observe(state, set);
    ASSERT_GT(set.size(), 0);
    const MatrixXd H = dense(set, n), expected = numerical(state, observe);
    const double scale = 1.0 + expected.cwiseAbs().maxCoeff();
    EXPECT_LT((H - expected).cwiseAbs().maxCoeff() / scale, tolerance);
  }
};

TEST_F(Estimate, ChainsWhatNoBoardTellsApart) {
  const auto group = [&](Joint joint) { return layout.group_of[index(joint)]; };
  EXPECT_EQ(group(Joint::kLeftToes), BodyLayout::kNoGroup);
  EXPECT_EQ(layout.groups, 20);
  EXPECT_EQ(n, 3 * (3 * 20 + 3) + 9 * 18 + 1);
  std::vector<std::vector<int>> longer;
  for (const auto& chain : layout.chains) {
    if (chain.size() > 1) longer.push_back(chain);
  }
  EXPECT_EQ(longer,
            (std::vector<std::vector<int>>{{group(Joint::kSpineLower), group(Joint::kSpineMiddle)},
                                           {group(Joint::kNeck), group(Joint::kHead)}}));
}

TEST_F(Estimate, CorrectsByTheDifference) {
  Draw draw(1);
  const BodyState a = draw.state(layout, rest(), 1.0), b = draw.state(layout, a, 0.3);
  VectorXd error(n);
  difference(layout, b, a, column(error));
  BodyState c = a;
  correct(layout, column(error), c);
  VectorXd rest_of_it(n);
  difference(layout, c, b, column(rest_of_it));
  EXPECT_LT(rest_of_it.cwiseAbs().maxCoeff(), 1e-12);
}

TEST_F(Estimate, MovesAsItsDerivativesSay) {
  // Positions, velocities and accelerations of boards against differences along the motion.
  Draw draw(2);
  for (int trial = 0; trial < 20; ++trial) {
    const BodyState state = draw.state(layout, rest(), 1.0);
    constexpr double kStep = 1e-4;
    for (std::size_t b = 0; b < garment.boards.size(); ++b) {
      PathMotion before, now, later;
      evaluate(skeleton, layout, state, body.fixed, body.segment_of[b], -kStep, before);
      evaluate(skeleton, layout, state, body.fixed, body.segment_of[b], 0.0, now);
      evaluate(skeleton, layout, state, body.fixed, body.segment_of[b], kStep, later);
      const PointMotion p0 = point(before, body.p_BS[b]), p1 = point(now, body.p_BS[b]),
                        p2 = point(later, body.p_BS[b]);
      const double speed = 1.0 + p1.v.norm(), push = 1.0 + p1.a.norm();
      EXPECT_LT(((p2.p - p0.p) / (2 * kStep) - p1.v).norm() / speed, 1e-4);
      EXPECT_LT(((p2.p - 2.0 * p1.p + p0.p) / (kStep * kStep) - p1.a).norm() / push, 2e-3);
      const Vector3d turned = rotation_vector(Eigen::Quaterniond(before.end().R).conjugate() *
                                              Eigen::Quaterniond(later.end().R));
      EXPECT_LT((now.end().R * turned / (2 * kStep) - now.end().w).norm(), 1e-3);
    }
  }
}

TEST_F(Estimate, HasTheJacobiansOfItsModels) {
  Draw draw(3);
  for (int trial = 0; trial < 4; ++trial) {
    const BodyState x = draw.state(layout, rest(), 1.0);
    const double time = trial % 2 == 0 ? 0.0 : -0.012;
    const std::size_t board = static_cast<std::size_t>(trial * 5) % garment.boards.size();
    const Vector3d z = draw.vector(2.0), z2 = draw.vector(1.0);
    expect_jacobian(x, [&](const BodyState& s, ObservationSet& set) {
      observe_gyro(body, s, board, time, z, 1.0, 0.0, set);
    });
    expect_jacobian(x, [&](const BodyState& s, ObservationSet& set) {
      observe_accel(body, s, board, time, z, 1.0, 0.0, set);
    });
    expect_jacobian(x, [&](const BodyState& s, ObservationSet& set) {
      observe_field(body, s, board, time, z, z2, 1.0, set);
    });
    expect_jacobian(x, [&](const BodyState& s, ObservationSet& set) {
      observe_distance_from(body, s, 2.0 * z2, board, time, 1.0, 1.0, set);
    });
    for (const PointQuantity quantity : {PointQuantity::kPosition, PointQuantity::kVelocity}) {
      expect_jacobian(x, [&](const BodyState& s, ObservationSet& set) {
        observe_point(body, s, quantity, index(Joint::kLeftAnkle), {0.1, 0.0, -0.05}, time, z, 1.0,
                      std::nullopt, set);
      });
      expect_jacobian(x, [&](const BodyState& s, ObservationSet& set) {
        observe_point(body, s, quantity, index(Joint::kRightToes), {0.1, 0.0, 0.0}, time, z, 1.0, 2,
                      set);
      });
    }
    expect_jacobian(x, [&](const BodyState& s, ObservationSet& set) {
      observe_root_rotation(body, s, time, quaternion_from(Vector3d(0.2, -0.3, 0.4)), 1.0, set);
    });
    expect_jacobian(x, [&](const BodyState& s, ObservationSet& set) {
      observe_likeness(layout.rotation(4, 1), layout.rotation(5, 1), s.groups[5].w - s.groups[4].w,
                       1.0, set);
    });
    expect_jacobian(x, [&](const BodyState& s, ObservationSet& set) {
      observe_rotation_along(body, s, 5, quaternion_from(z2), 1.0, set);
    });
    int heard = 0;
    for (std::size_t source = 0; source < garment.sources.size(); ++source) {
      for (std::size_t b = 0; b < garment.boards.size(); ++b) {
        ObservationSet probe(layout, 4);
        if (!observe_distance(body, x, source, b, time, 0.003, 0.7, 1.0, probe)) continue;
        if (heard++ % 11 != 0) continue;
        expect_jacobian(x, [&](const BodyState& s, ObservationSet& set) {
          observe_distance(body, s, source, b, time, 0.003, 0.7, 1.0, set);
        });
      }
    }
    EXPECT_GT(heard, 0);
  }
}

TEST_F(Estimate, HearsNothingBehindASource) {
  // In the rest pose the back's board is behind the belly's sources, the thighs are not.
  BodyState x = rest();
  ObservationSet set(layout, 64);
  EXPECT_FALSE(observe_distance(body, x, 1, 1, 0.0, 0.0, 0.3, 1.0, set));
  EXPECT_EQ(set.size(), 0);
  // Distances are true ones between places (Eq. 4).
  PathMotion hat, foot;
  evaluate(skeleton, layout, x, body.fixed, index(Joint::kHead), 0.0, hat);
  evaluate(skeleton, layout, x, body.fixed, index(Joint::kLeftAnkle), 0.0, foot);
  const double distance =
      (point(hat, body.X_BU[7].translation()).p - point(foot, body.p_BS[10]).p).norm();
  EXPECT_TRUE(observe_distance(body, x, 7, 10, 0.0, 0.0, distance, 1.0, set));
  EXPECT_NEAR(set.y.back(), 0.0, 1e-12);
}

TEST_F(Estimate, FeelsGravityAndTurning) {
  BodyState x = rest();
  ObservationSet set(layout, 8);
  observe_accel(body, x, 0, 0.0, Vector3d::Zero(), 1.0, 0.0, set);
  EXPECT_NEAR(Vector3d(-set.y[0], -set.y[1], -set.y[2]).z(), kGravity.z(), 1e-12);
  // On a thigh that spins about the hip with w, r from it: w^2 r towards the hip.
  set.clear();
  const std::size_t thigh = 8;
  ASSERT_EQ(garment.boards[thigh].segment, Joint::kLeftHip);
  const auto hip = static_cast<std::size_t>(layout.group_of[index(Joint::kLeftHip)]);
  x.groups[hip].w = {0.0, 5.0, 0.0};
  observe_accel(body, x, thigh, 0.0, kGravity, 1.0, 0.0, set);
  const Vector3d& r = body.p_BS[thigh];
  EXPECT_NEAR(set.y[0], 25.0 * r.x(), 1e-9);
  EXPECT_NEAR(set.y[1], 0.0, 1e-9);
  EXPECT_NEAR(set.y[2], 25.0 * r.z(), 1e-9);
}

TEST_F(Estimate, CarriesTheCovarianceAsTheStateMoves) {
  Draw draw(5);
  const BodyState x = draw.state(layout, rest(), 1.0);
  constexpr double kTime = 0.01, kStep = 1e-6;
  BodyState after_it = x;
  propagate(after_it, kTime);
  MatrixXd F(n, n);
  for (int c = 0; c < n; ++c) {
    VectorXd error = VectorXd::Zero(n), moved(n);
    error[c] = kStep;
    BodyState y = x;
    correct(layout, column(error), y);
    propagate(y, kTime);
    difference(layout, y, after_it, column(moved));
    F.col(c) = moved / kStep;
  }
  Covariance P(layout, 64);
  VectorXd variance(n);
  for (int c = 0; c < n; ++c) P.reset(c, variance[c] = 0.5 + std::abs(draw.normal(1.0)));
  P.predict(x, kTime, {});
  const MatrixXd expected = F * variance.asDiagonal() * F.transpose();
  EXPECT_LT((dense(P, n) - expected).cwiseAbs().maxCoeff(), 1e-5);
}

TEST_F(Estimate, DrivesTheStateByWhiteJerkWhateverTheStep) {
  // Q of one step of 20 ms is that of ten of 2 ms (state at rest).
  const BodyState x = rest();
  const ProcessNoise noise{9.0, 4.0, 2.0, 1.0, 1e-3, 1e-2, 1e-4, 1e-5};
  Covariance once(layout, 8), often(layout, 8);
  once.clear();
  often.clear();
  once.predict(x, 0.02, noise);
  for (int i = 0; i < 10; ++i) often.predict(x, 0.002, noise);
  const MatrixXd difference = dense(once, n) - dense(often, n);
  EXPECT_LT(difference.cwiseAbs().maxCoeff(), 1e-15);
  EXPECT_NEAR(once.at(layout.rotation(3, 0), layout.rotation(3, 0)), 9.0 * std::pow(0.02, 5) / 20,
              1e-18);
  EXPECT_NEAR(once.at(layout.rotation(3, 2), layout.rotation(3, 2)), 9.0 * 0.02, 1e-15);
  // The acceleration of neck and head together is that of one joint, of one against the other less.
  const int neck = layout.rotation(layout.group_of[index(Joint::kNeck)], 2);
  const int head = layout.rotation(layout.group_of[index(Joint::kHead)], 2);
  const double own = once.at(neck, neck) + once.at(head, head), both = 2.0 * once.at(neck, head);
  EXPECT_NEAR(own + both, 9.0 * 0.02, 1e-15);
  EXPECT_NEAR(own - both, 2.0 * 1.0 * 0.02, 1e-15);
}

TEST_F(Estimate, UpdatesAsTheDenseEquationsDo) {
  // Eq. 7 to 9 in full matrices, over some steps so that everything correlates.
  Draw draw(7);
  BodyState x = draw.state(layout, rest(), 0.3);
  Covariance P(layout, 64);
  for (int c = 0; c < n; ++c) P.reset(c, 0.1);
  ObservationSet set(layout, 64);
  std::vector<double> error(static_cast<std::size_t>(P.padded_size()));
  std::vector<char> relax(64, 0), passed(64);
  for (int step = 0; step < 4; ++step) {
    P.predict(x, 0.01, {1.0, 1.0, 1.0, 0.1, 1e-4, 1e-4, 1e-4, 1e-6});
    set.clear();
    for (std::size_t b = 0; b < garment.boards.size(); ++b) {
      if (step % 2 == 0) observe_gyro(body, x, b, 0.0, draw.vector(1.0), 0.1, 0.0, set);
      if (step % 2 == 1) {
        observe_distance(body, x, 7, b, -0.005, 0.003, 1.0, 0.01, set);
      }
    }
    const MatrixXd before = dense(P, n), H = dense(set, n);
    const Eigen::Map<const VectorXd> y(set.y.data(), set.size()),
        R(set.variance.data(), set.size());
    const MatrixXd S = H * before * H.transpose() + MatrixXd(R.asDiagonal());
    const MatrixXd K = before * H.transpose() * S.inverse();
    const UpdateResult result = P.update(set, {1e9, 1e9, 1e9}, relax, passed, error);
    EXPECT_EQ(result.rows, set.size());
    EXPECT_NEAR(result.nis, y.dot(S.inverse() * y), 1e-8 * result.nis);
    EXPECT_LT((dense(P, n) - (before - K * H * before)).cwiseAbs().maxCoeff(), 1e-11);
    EXPECT_LT((Eigen::Map<const VectorXd>(error.data(), n) - K * y).cwiseAbs().maxCoeff(), 1e-10);
    EXPECT_EQ(dense(P, n), dense(P, n).transpose().eval());
  }
}

TEST_F(Estimate, LeavesOutWhatDoesNotPassItsGate) {
  Draw draw(8);
  const BodyState x = draw.state(layout, rest(), 0.3);
  Covariance P(layout, 64), Q(layout, 64);
  for (int c = 0; c < n; ++c) P.reset(c, 0.01), Q.reset(c, 0.01);
  ObservationSet with(layout, 64), without(layout, 64);
  std::vector<double> e1(static_cast<std::size_t>(P.padded_size())), e2(e1);
  std::vector<char> relax(64, 0), passed(64);
  for (std::size_t b = 0; b < 6; ++b) {
    const auto& w = x.groups[0].w;
    const Vector3d z = b == 2 ? Vector3d(1e3, 0, 0) : b == 4 ? Vector3d::Constant(NAN) : w;
    observe_gyro(body, x, b, 0.0, z, 100.0, 0.0, with);
    if (b != 2 && b != 4) observe_gyro(body, x, b, 0.0, z, 100.0, 0.0, without);
  }
  P.update(with, {10.8, 13.8, 16.3}, relax, passed, e1);
  EXPECT_TRUE(passed[0] && passed[1] && !passed[2] && passed[3] && !passed[4] && passed[5]);
  Q.update(without, {1e9, 1e9, 1e9}, relax, passed, e2);
  EXPECT_LT((dense(P, n) - dense(Q, n)).cwiseAbs().maxCoeff(), 1e-14);
  for (std::size_t c = 0; c < e1.size(); ++c) EXPECT_NEAR(e1[c], e2[c], 1e-13);
}

}  // namespace
}  // namespace secondskin::server
