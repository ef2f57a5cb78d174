#include "server/wearable/estimate/body_filter.h"

#include <gtest/gtest.h>

#include <functional>

#include "motion/rotation.h"
#include "tests/wearable/resting_garment.h"

namespace secondskin::server {
namespace {

using Eigen::Vector3d;

class RestingFilter : public testing::Test {
 protected:
  static constexpr std::int64_t kStep = 7'142'857;
  const Skeleton skeleton = canonical_skeleton();
  const Garment garment = practical_garment();
  const std::vector<Eigen::Isometry3d> X_BS = places(skeleton, garment);
  BodyFilter filter{skeleton, garment, X_BS, {}};
  std::int64_t now = 0;

  RestingFilter() { filter.start(Pose(kJointCount), 0, {}); }

  void rest(double seconds, const std::function<void(Measurement&)>& change = {}) {
    for (const auto until = now + static_cast<std::int64_t>(seconds * 1e9); now < until;) {
      now += kStep;
      Measurement m = resting_inertial(garment, X_BS, now);
      if (change) change(m);
      filter.process(m);
    }
  }
  double worst_joint() const {
    double worst = 0.0;
    for (const Eigen::Quaterniond& q : filter.pose().q_PB) {
      worst = std::max(worst, geodesic_distance(q, Eigen::Quaterniond::Identity()));
    }
    return worst;
  }
};

TEST_F(RestingFilter, StandsStill) {
  rest(1.0);
  EXPECT_LT(worst_joint(), 1e-6);
  EXPECT_LT(filter.pose().p_WR.norm(), 1e-6);
  EXPECT_EQ(filter.counts()[3].gyro.used, 141u);
  EXPECT_EQ(filter.counts()[3].accel.gated, 0u);
  EXPECT_GT(filter.pose().confidence[index(Joint::kLeftElbow)], 0.8F);
  EXPECT_EQ(filter.pose().confidence[index(Joint::kLeftToes)], 0.0F);
}

TEST_F(RestingFilter, CountsWhatIsMissing) {
  rest(0.1, [&](Measurement& m) {
    m.boards[0].gyro_valid = false;
    m.boards[1].gyro.x() = NAN;
    m.boards[2].gyro.x() = garment.boards[2].gyro_range;
    m.boards[3].accel.z() = -garment.boards[3].accel_range;
    m.boards.resize(17);  // a board short
  });
  for (const std::size_t b : {0, 1, 2}) {
    EXPECT_EQ(filter.counts()[b].gyro.missing, 15u);
    EXPECT_EQ(filter.counts()[b].gyro.used, 0u);
  }
  EXPECT_EQ(filter.counts()[3].accel.missing, 15u);
  EXPECT_EQ(filter.counts()[3].gyro.used, 15u);
  EXPECT_TRUE(filter.pose().is_valid());
  EXPECT_LT(worst_joint(), 1e-6);
}

TEST_F(RestingFilter, IsNotStarvedByItsGates) {
  // The left forearm's gyroscope jumps by more than any gate lets pass, and stays there.
  const std::size_t board = 6;
  FilterSettings calm;
  calm.joint_jerk = calm.root_turn_jerk = 20.0;
  calm.gyro_noise = 0.02;
  filter = BodyFilter(skeleton, garment, X_BS, calm);
  filter.start(Pose(kJointCount), 0, {});
  rest(0.5);
  rest(1.0, [&](Measurement& m) { m.boards[board].gyro.x() += 8.0; });
  const ReadingCounts wrong = filter.counts()[board].gyro;
  EXPECT_GT(wrong.gated, 10u);
  EXPECT_GT(wrong.used, 71u);  // it gave in
  rest(1.0);
  const auto recovered = filter.counts()[board].gyro.used;
  rest(1.0);
  EXPECT_GE(filter.counts()[board].gyro.used, recovered + 140u);
  EXPECT_TRUE(filter.pose().is_valid());
}

TEST_F(RestingFilter, RefusesWhatIsTooOldAndTakesWhatIsALittleLate) {
  rest(1.0);
  filter.process(resting_inertial(garment, X_BS, now - BodyFilter::kOldest - 1));
  EXPECT_EQ(filter.late(), 1u);
  filter.process(resting_inertial(garment, X_BS, now - BodyFilter::kOldest / 2));
  EXPECT_EQ(filter.late(), 1u);
  EXPECT_EQ(filter.stamp_ns(), now);
  EXPECT_LT(worst_joint(), 1e-6);
}

TEST_F(RestingFilter, OutlastsSilence) {
  rest(0.5);
  const Vector3d sure = filter.sigma(Joint::kLeftElbow);
  for (const std::int64_t gap : {1'000'000'000LL, 60'000'000'000LL}) {
    now += gap;
    filter.process(resting_inertial(garment, X_BS, now));
    EXPECT_TRUE(filter.pose().is_valid());
    EXPECT_TRUE(filter.sigma(Joint::kLeftElbow).allFinite());
    EXPECT_GT(filter.sigma(Joint::kLeftElbow).x(), 3.0 * sure.x());
  }
  rest(1.0);
  EXPECT_TRUE(filter.pose().is_valid());
}

TEST_F(RestingFilter, GoesOnWithoutABoardAndGrowsUnsure) {
  const std::size_t thigh = 8;
  rest(5.0,
       [&](Measurement& m) { m.boards[thigh].gyro_valid = m.boards[thigh].accel_valid = false; });
  EXPECT_GT(filter.sigma(Joint::kLeftHip).norm(), 2.0 * filter.sigma(Joint::kRightHip).norm());
  EXPECT_TRUE(filter.sigma(Joint::kLeftHip).allFinite());
  rest(1.0);
  EXPECT_GT(filter.counts()[thigh].gyro.used, 130u);
}

TEST_F(RestingFilter, FollowsWhatIsKnownOfTheRoot) {
  Eigen::Isometry3d X_WR = Eigen::Isometry3d::Identity();
  X_WR.translation() = Vector3d(0.1, -0.05, 0.02);
  X_WR.linear() = quaternion_from(Vector3d(0.0, 0.0, 0.05)).toRotationMatrix();
  for (int i = 0; i < 140; ++i) {
    rest(0.007);
    filter.observe_root(now, X_WR, 0.002, 0.002);
  }
  EXPECT_LT((filter.pose().p_WR - X_WR.translation()).norm(), 0.005);
  EXPECT_LT(geodesic_distance(filter.pose().q_PB[0], Eigen::Quaterniond(X_WR.linear())), 0.005);
  EXPECT_LT(filter.root_covariance().diagonal().maxCoeff(), 1e-4);
}

TEST_F(RestingFilter, TakesPointsAndDirections) {
  const std::size_t foot = index(Joint::kLeftAnkle);
  const double before = filter.root_covariance()(2, 2);
  EXPECT_TRUE(filter.observe_point_height(
      now, foot, Vector3d::Zero(), filter.point_position(foot, Vector3d::Zero()).z(), 0.001));
  EXPECT_LT(filter.root_covariance()(2, 2), before);
  EXPECT_TRUE(filter.observe_point_velocity(now, foot, Vector3d::Zero(), Vector3d::Zero(), 0.01));
  EXPECT_FALSE(filter.observe_point_velocity(now, foot, Vector3d::Zero(), Vector3d(9, 9, 9), 0.01));
  EXPECT_FALSE(filter.observe_point_height(now, foot, Vector3d::Zero(), NAN, 0.01));
  const Vector3d north(1.0, 0.0, -1.0);
  EXPECT_TRUE(filter.observe_direction(now, 0, X_BS[0].linear().transpose() * north, north, 0.02));
  EXPECT_FALSE(filter.observe_direction(now, 0, Vector3d::Zero(), north, 0.02));
  EXPECT_LT(worst_joint(), 1e-6);
}

TEST(BodyFilter, RefusesWhatDoesNotFit) {
  const Skeleton skeleton = canonical_skeleton();
  const Garment garment = practical_garment();
  EXPECT_THROW(BodyFilter(skeleton, garment, {}, {}), std::invalid_argument);
  BodyFilter filter(skeleton, garment, places(skeleton, garment), {});
  EXPECT_THROW(filter.start(Pose(3), 0, {}), std::invalid_argument);
  EXPECT_THROW(filter.start(Pose(kJointCount), 0, std::vector<BoardBias>(2)),
               std::invalid_argument);
  Garment crowded = garment;  // more rows of gyroscopes than an update can hold
  while (crowded.boards.size() <= 85) crowded.boards.push_back(garment.boards[0]);
  EXPECT_THROW(BodyFilter(skeleton, crowded, places(skeleton, crowded), {}), std::invalid_argument);
}

}  // namespace
}  // namespace secondskin::server
