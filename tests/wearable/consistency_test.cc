#include <gtest/gtest.h>

#include <boost/math/distributions/chi_squared.hpp>

#include "tests/wearable/model_run.h"

namespace secondskin::server {
namespace {

/// Whether a chi-square sum lies in the two-sided 95 % band of its degrees of freedom.
testing::AssertionResult in_band(double sum, double freedom) {
  const boost::math::chi_squared law(freedom);
  const double low = boost::math::quantile(law, 0.025), high = boost::math::quantile(law, 0.975);
  auto result =
      sum >= low && sum <= high ? testing::AssertionSuccess() : testing::AssertionFailure();
  return result << sum / freedom << " a degree of freedom, band " << low / freedom << " to "
                << high / freedom;
}

// Bar-Shalom et al., "Estimation with Applications to Tracking and Navigation", 5.4: on motion,
// offsets and noise drawn from the model, the normalised squares of errors and innovations are
// chi-square. Each run is one sample of the state's error at its end.
TEST(Consistency, IsHonestOnMotionDrawnFromTheModel) {
  ModelRun model;
  constexpr int kRuns = 12;
  double nees = 0.0, joints = 0.0;
  InnovationFit gyro, accel, distance;
  for (int i = 0; i < kRuns; ++i) {
    const ModelResult result = model.run(static_cast<std::uint64_t>(i + 1), 0.5);
    nees += result.nees;
    joints += result.joint_nees;
    const auto add = [](InnovationFit& sum, const InnovationFit& fit) {
      sum.nis += fit.nis;
      sum.rows += fit.rows;
    };
    add(gyro, result.gyro);
    add(accel, result.accel);
    add(distance, result.distance);
  }
  const double n = model.layout().size();
  EXPECT_TRUE(in_band(nees, kRuns * n));
  EXPECT_TRUE(in_band(joints, kRuns * 3.0 * model.layout().groups));
  EXPECT_TRUE(in_band(gyro.nis, static_cast<double>(gyro.rows)));
  EXPECT_TRUE(in_band(accel.nis, static_cast<double>(accel.rows)));
  EXPECT_TRUE(in_band(distance.nis, static_cast<double>(distance.rows)));
  EXPECT_GT(gyro.rows, 30000u);
  EXPECT_GT(distance.rows, 1000u);
}

TEST(Consistency, IsTooSureWhenNoiseIsTenTimesTheModels) {
  ModelRun model;
  model.true_noise_scale = 10.0;
  const ModelResult result = model.run(1, 0.3);
  EXPECT_GT(result.gyro.nis, 2.0 * static_cast<double>(result.gyro.rows));
  EXPECT_GT(result.nees, 2.0 * model.layout().size());
}

TEST(Consistency, KeepsTheCovariancePositive) {
  ModelRun model;
  const ModelResult result = model.run(3, 1.0);
  EXPECT_GT(result.least_eigenvalue, 0.0);
}

}  // namespace
}  // namespace secondskin::server
