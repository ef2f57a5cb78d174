#include "coach/tactile/saltation.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

namespace secondskin::coach {
namespace {

// Goldreich 2007, forearm: the ratio at 20, 30, 50, 80, 100, 150, 200, 300 ms.
TEST(Saltation, ShrinksTheFeltDistanceAsGoldreichHasIt) {
  const std::vector<std::pair<double, double>> table{{0.020, 0.020}, {0.030, 0.043}, {0.050, 0.111},
                                                     {0.080, 0.242}, {0.100, 0.333}, {0.150, 0.529},
                                                     {0.200, 0.667}, {0.300, 0.818}};
  for (const auto& [interval, ratio] : table) {
    EXPECT_NEAR(felt_distance_ratio(interval), ratio, 0.0006);
  }
  EXPECT_EQ(felt_distance_ratio(0.0), 0.0);
  // Figure 9: at 4 cm the felt speed peaks with 14.14 cm/s, at a real one of 28.28 cm/s.
  double fastest = 0.0, at = 0.0;
  for (double interval = 0.02; interval < 1.0; interval += 1e-4) {
    const double speed = 4.0 * felt_distance_ratio(interval) / interval;
    if (speed > fastest) fastest = speed, at = 4.0 / interval;
  }
  EXPECT_NEAR(fastest, 14.14, 0.01);
  EXPECT_NEAR(at, 28.28, 0.1);
}

TEST(Saltation, FeelsManyTapsWhereTheyAreLikeliest) {
  for (const double interval : {0.02, 0.06, 0.15}) {
    const std::vector<double> two{0.0, 1.0};
    std::vector<double> felt(2);
    felt_positions(two, interval, kForearmLambda, felt);
    EXPECT_NEAR(felt[1] - felt[0], felt_distance_ratio(interval), 1e-12);
    EXPECT_NEAR(felt[0] + felt[1], 1.0, 1e-12);

    // The minimum of the stated cost: its gradient is zero.
    const std::vector<double> real{0, 0, 1, 1, 2, 2, 3, 3};
    felt.resize(real.size());
    felt_positions(real, interval, kForearmLambda, felt);
    const double lt2 = std::pow(kForearmLambda * interval, 2);
    for (std::size_t i = 0; i < real.size(); ++i) {
      double gradient = lt2 * (felt[i] - real[i]);
      if (i > 0) gradient += felt[i] - felt[i - 1];
      if (i + 1 < real.size()) gradient += felt[i] - felt[i + 1];
      EXPECT_NEAR(gradient, 0.0, 1e-12);
      if (i > 0) {
        EXPECT_GT(felt[i], felt[i - 1]);  // the hops of the rabbit, never back
      }
    }
  }
}

}  // namespace
}  // namespace secondskin::coach
