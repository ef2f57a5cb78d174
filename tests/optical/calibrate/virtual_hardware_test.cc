// The whole way: what the virtual projectors send to the virtual grid and wand (sim/optical), bit
// by bit at its own time, becomes a calibration that is compared with their true geometry.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <optional>

#include "server/optical/calibrate/grid_calibration.h"
#include "server/optical/calibrate/wand_calibration.h"
#include "sim/optical/calibration_scenes.h"
#include "sim/optical/virtual_rig.h"
#include "tests/optical/calibrate/synthetic.h"

namespace secondskin::server {
namespace {

sim::OpticalNoise noise() {
  sim::OpticalNoise noise;
  noise.wild_share = 0.02;
  return noise;
}

std::vector<Projector> truth() {
  std::vector<Projector> out;
  for (const sim::VirtualProjector& p : sim::second_skin_rig()) out.push_back({p.matrix()});
  return out;
}

void run(sim::VirtualRig& rig, std::size_t detectors, double from, double to,
         const std::function<void(const ProjectorFrame&)>& take) {
  const auto first = static_cast<std::uint64_t>(from / 0.016);
  for (std::uint64_t cycle = first; 0.016 * static_cast<double>(cycle) < to; ++cycle) {
    ProjectorFrame frame(detectors, 16);
    frame.cycle = cycle;
    frame.stamp_ns = static_cast<std::int64_t>(cycle) * wire::cycle_ns(16);
    rig.cycle(0.016 * static_cast<double>(cycle), frame.values);
    take(frame);
  }
}

// RMS of points after a calibration by the grid at these heights, whose readings all fit.
double grid_error(const std::vector<double>& heights) {
  CalibrationGrid grid;
  grid.heights = heights;
  std::optional<GridCalibration> session;
  for (std::size_t h = 0; h < heights.size(); ++h) {
    // So high over the floor that the projectors on the near side light it.
    sim::GridScene scene(0.35 + heights[h]);
    if (h == 0) {
      grid.p_W.assign(scene.positions().begin(), scene.positions().end());
      session.emplace(grid, 16);
    }
    sim::VirtualRig rig(sim::second_skin_rig(), scene, noise(), 5 + h);
    run(rig, 12, 0.0, 16.0, [&](const ProjectorFrame& frame) { session->add(frame, h); });
  }
  const auto result = session->solve();
  if (!result) {
    ADD_FAILURE() << result.error().text;
    return std::numeric_limits<double>::infinity();
  }
  for (const auto& p : result->projectors) {
    EXPECT_FALSE(p.refused);
    EXPECT_LT(p.residual, 0.1);
  }
  return test::rig_error(truth(), result->rig, false);
}

// What is quadratic in height hardly shows at two heights; a third one fixes it.
TEST(VirtualHardware, IsCalibratedByTheGridToMillimetresAndBetterWithAThirdHeight) {
  const double two = grid_error({0.0, sim::GridScene::kRaised});
  const double three = grid_error({0.0, 0.5 * sim::GridScene::kRaised, sim::GridScene::kRaised});
  EXPECT_LT(two, 4e-3);
  EXPECT_LT(three, 2e-3);
  EXPECT_LT(three, two);
}

TEST(VirtualHardware, IsCalibratedByTheWandToMillimetresWithoutAGuess) {
  for (std::uint64_t seed = 1; seed <= 2; ++seed) {
    sim::WandOptions options;
    options.wave = 60.0;
    sim::WandScene scene(options, seed);
    Wand wand;
    for (const Eigen::Vector3d& p_TD : options.p_TD) {
      wand.lying_W.push_back(p_TD + options.rest_height * Eigen::Vector3d::UnitZ());
    }
    WandSession session(wand, 16);
    sim::VirtualRig rig(sim::second_skin_rig(), scene, noise(), seed);
    run(rig, 3, 0.0, scene.rests_from() + 2.0,
        [&](const ProjectorFrame& frame) { session.add(frame); });
    const auto result = session.solve();
    ASSERT_TRUE(result) << result.error().text;
    EXPECT_TRUE(result->enough()) << result->wishes.front();
    EXPECT_LT(test::rig_error(truth(), result->rig, true), 1e-3);
    EXPECT_LT(test::rig_error(truth(), result->rig, false), 3e-3);
    EXPECT_LT(result->predicted_error, 1e-3);
  }
}

}  // namespace
}  // namespace secondskin::server
