#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <limits>
#include <numbers>

#include "motion/kinematics.h"
#include "motion/retarget.h"
#include "motion/rotation.h"
#include "server/wearable/start/initialise.h"
#include "sim/wearable/simulated_measurements.h"
#include "sim/wearable/worn_garment.h"
#include "tests/wearable/functional_movements.h"

namespace secondskin::server {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr double kDegree = std::numbers::pi / 180.0;
const std::filesystem::path kSource(SECONDSKIN_SOURCE_DIR);

Garment practical() { return Garment::load(kSource / "garments/practical.toml"); }

struct Felt {
  Rest rest;
  Movement movement;
};

Felt feel(const sim::WornGarment& worn, std::uint64_t seed,
          const sim::MeasurementOptions& options) {
  sim::SimulatedMeasurements stream(worn, seed, options);
  RestFinder finder(worn.garment());
  std::optional<Rest> rest;
  std::optional<Movement> movement;
  Measurement m;
  while (stream.next(m) == Next::kPose) {
    if (rest) {
      movement->add(m);
    } else if (finder.add(m)) {
      rest = finder.rest();
      movement.emplace(worn.garment(), *rest);
    }
  }
  if (!rest) throw std::runtime_error("no rest was found");
  return {*rest, *movement};
}

const Motion& movements() {
  static const Motion motion = functional_movements(1);
  return motion;
}

std::size_t board(const Garment& garment, std::string_view name) {
  for (std::size_t b = 0; b < garment.boards.size(); ++b) {
    if (garment.boards[b].name == name) return b;
  }
  throw std::runtime_error("no such board");
}

// How a mounting is off, about the axes of the segment.
Eigen::Vector3d off(const Eigen::Isometry3d& found, const Eigen::Isometry3d& truth) {
  return rotation_vector(Eigen::Quaterniond(found.linear() * truth.linear().transpose()));
}

TEST(RestFinder, FindsTheStillPhaseThroughTheSixBitCode) {
  const sim::WornGarment worn(movements(), practical(), sim::WornErrors{}, 3);
  for (const bool codec : {false, true}) {
    sim::MeasurementOptions options;
    options.codec = codec;
    const Rest rest = feel(worn, 3, options).rest;
    const double length = 1e-9 * static_cast<double>(rest.end_ns - rest.begin_ns);
    EXPECT_GT(length, 2.0);
    EXPECT_LT(1e-9 * static_cast<double>(rest.end_ns), 3.6) << "blends into movement";
    for (const BoardRest& board : rest.boards) EXPECT_LT(board.gyro.norm(), 2.0 * kDegree);
  }
}

TEST(RestFinder, FindsNoneInSteadyTurning) {
  const Garment garment = practical();
  RestFinder finder(garment);
  Measurement m;
  m.boards.resize(garment.boards.size());
  for (int i = 0; i < 1000; ++i) {
    m.stamp_ns = i * 7'142'857LL;
    for (auto& reading : m.boards) {
      reading.gyro = {0.0, 0.0, 0.5};
      reading.accel = {0.0, 0.0, 9.8};
      reading.gyro_valid = reading.accel_valid = true;
    }
    ASSERT_FALSE(finder.add(m));
  }
  EXPECT_FALSE(finder.rest());
}

TEST(FitRest, PutsTheBoardsUprightAndDoesNotLoseTheBones) {
  const Garment garment = practical();
  for (const std::uint64_t seed : {1u, 2u, 3u}) {
    const sim::WornGarment worn(movements(), garment, sim::WornErrors{}, seed);
    const Rest rest = feel(worn, seed, {}).rest;
    const Skeleton& body = worn.assumed_skeleton();
    const auto nominal = nominal_places(body, garment);
    std::array<double, kBones> sigma;
    sigma.fill(0.015);
    const auto fit = fit_rest(body, sigma, garment, Pose(kJointCount), nominal,
                              std::vector<bool>(garment.boards.size(), true), rest);
    double before = 0.0, after = 0.0, bones_before = 0.0, bones_after = 0.0;
    for (std::size_t b = 0; b < garment.boards.size(); ++b) {
      before += off(nominal[b], worn.mounted(b)).head<2>().squaredNorm();
      after += off(fit.X_BS[b], worn.mounted(b)).head<2>().squaredNorm();
    }
    for (std::size_t i = 1; i < kJointCount; ++i) {
      const double truth = worn.skeleton()[i].p_PB.norm();
      bones_before += std::pow(body[i].p_PB.norm() / truth - 1.0, 2);
      bones_after += std::pow(fit.skeleton[i].p_PB.norm() / truth - 1.0, 2);
    }
    EXPECT_LT(std::sqrt(after / 18.0), 2.0 * kDegree);
    EXPECT_LT(after, 0.25 * before);
    EXPECT_LT(fit.gravity, 0.3 * kDegree);
    EXPECT_GT(fit.distances, 20u);
    EXPECT_LT(fit.distance, 0.75 * fit.distance_before);  // the rest is noise of weak pulses
    EXPECT_LT(std::sqrt(bones_after), 1.3 * std::sqrt(bones_before));
  }
}

TEST(FitRest, FindsALegThatIsLongerThanAssumed) {
  const Garment garment = practical();
  sim::WornErrors none = sim::WornErrors::none();
  none.distance_noise = 0.0025;
  const sim::WornGarment worn(movements(), garment, none, 1);
  const Rest rest = feel(worn, 1, {}).rest;
  std::array<double, kBones> truth;
  truth.fill(1.0);
  std::array<double, kBones> assumed = truth;
  assumed[static_cast<std::size_t>(Bone::kThigh)] = 0.96;
  std::array<double, kBones> sigma;
  sigma.fill(0.01);
  sigma[static_cast<std::size_t>(Bone::kThigh)] = 0.05;
  const Skeleton body = scaled(worn.skeleton(), assumed);
  const auto fit = fit_rest(body, sigma, garment, Pose(kJointCount), nominal_places(body, garment),
                            std::vector<bool>(garment.boards.size(), true), rest);
  EXPECT_NEAR(fit.bone_scale[static_cast<std::size_t>(Bone::kThigh)], 1.0 / 0.96, 0.02);
  EXPECT_LT(fit.bone_sigma[static_cast<std::size_t>(Bone::kThigh)], 0.03);
}

// What a live garment does: its skeleton is told before anybody stands still.
TEST(Initialise, KeepsTheBonesThatItIsToldToKeep) {
  const Garment garment = practical();
  const sim::WornGarment worn(movements(), garment, sim::WornErrors{}, 2);
  StartSettings settings;
  settings.refine_bones = false;
  const StartResult result = initialise(garment, settings, feel(worn, 2, {}).rest);
  EXPECT_THAT(result.swapped, IsEmpty());
  EXPECT_LT(result.fit.gravity, 0.3 * kDegree);
  EXPECT_LT(result.fit.distance, 0.02);
  for (const double scale : result.fit.bone_scale) EXPECT_NEAR(scale, 1.0, 1e-3);
}

TEST(Initialise, NamesAndUndoesBoardsSwappedAtTheInitialPose) {
  const Garment garment = practical();
  const sim::WornGarment worn(movements(), garment, sim::WornErrors{}, 2);
  EXPECT_THAT(initialise(garment, {}, feel(worn, 2, {}).rest).swapped, IsEmpty());
  for (const char* name : {"shoulder", "thigh", "foot"}) {
    const auto left = board(garment, std::string("left_") + name);
    const auto right = board(garment, std::string("right_") + name);
    sim::MeasurementOptions options;
    options.faults.swapped = {{left, right}};
    const auto result = initialise(garment, {}, feel(worn, 2, options).rest);
    ASSERT_EQ(result.swapped.size(), 1u) << name;
    EXPECT_EQ(result.swapped[0].left, left);
    EXPECT_EQ(result.channel[left], right);
    EXPECT_EQ(result.channel[right], left);
    EXPECT_THAT(result.warnings, Contains(HasSubstr(std::string("left_") + name + " and right_" +
                                                    name + " are swapped")));
  }
}

TEST(Initialise, NamesBoardsThatMoveWithTheOtherSide) {
  const Garment garment = practical();
  const sim::WornGarment worn(movements(), garment, sim::WornErrors{}, 2);
  EXPECT_THAT(swapped_by_movement(garment, feel(worn, 2, {}).movement), IsEmpty());
  for (const char* name : {"upper_arm", "forearm", "hand", "thigh", "shank", "foot"}) {
    const auto left = board(garment, std::string("left_") + name);
    sim::MeasurementOptions options;
    options.distances = false;
    options.faults.swapped = {{left, board(garment, std::string("right_") + name)}};
    const auto swaps = swapped_by_movement(garment, feel(worn, 2, options).movement);
    ASSERT_EQ(swaps.size(), 1u) << name;
    EXPECT_EQ(swaps[0].left, left) << name;
  }
}

TEST(Initialise, FindsTheHeadingOfBoardsThatSitAsTheyMay) {
  const Garment garment = practical();
  const sim::WornGarment worn(movements(), garment, sim::WornErrors{}, 1);
  const auto felt = feel(worn, 1, {});
  StartSettings settings;
  settings.mountings.assign(garment.boards.size(), std::nullopt);
  // As if the garment's file knew nothing: each board is thought to be turned.
  Garment turned = garment;
  for (std::size_t b = 0; b < turned.boards.size(); ++b) {
    turned.boards[b].turn += 0.7 * static_cast<double>(b);
  }
  const auto result = initialise(turned, settings, felt.rest, &felt.movement);
  std::size_t found = 0;
  for (std::size_t b = 0; b < garment.boards.size(); ++b) {
    const Eigen::Vector3d e = off(result.X_BS[b], worn.mounted(b));
    if (!result.headings[b].found) {
      EXPECT_THAT(result.warnings,
                  Contains(HasSubstr(garment.boards[b].name + ": its heading is not known")));
      continue;
    }
    ++found;
    EXPECT_LT(std::abs(e.z()), 25.0 * kDegree) << garment.boards[b].name;
    EXPECT_LT(std::abs(e.z()), 3.5 * result.headings[b].sigma) << garment.boards[b].name;
    EXPECT_LT(e.head<2>().norm(), 6.0 * kDegree) << garment.boards[b].name;
  }
  EXPECT_GE(found, 13u);
}

TEST(Starter, SaysWhatToDoWhenNobodyStandsStill) {
  Starter starter(practical(), {});
  try {
    (void)starter.finish();
    FAIL();
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), HasSubstr("stood still for 0.5 s"));
  }
}

TEST(Wearer, HasTheMeasuredLengthsAndRefusesImpossibleOnes) {
  Wearer wearer;
  wearer.stature = 1.80;
  wearer.upper_arm = 0.36;
  wearer.hip_height = 0.97;
  wearer.knee_height = 0.52;
  wearer.shoulder_width = 0.42;
  const Skeleton body = wearer_skeleton(wearer);
  EXPECT_NEAR(body[index(Joint::kLeftElbow)].p_PB.norm(), 0.36, 1e-9);
  std::vector<Eigen::Isometry3d> X_WB(kJointCount);
  Pose rest(kJointCount);
  forward_kinematics(body, rest.p_WR, rest.q_PB, X_WB);
  const auto at = [&](Joint joint) { return X_WB[index(joint)].translation(); };
  EXPECT_NEAR((at(Joint::kLeftShoulder) - at(Joint::kRightShoulder)).y(), 0.42, 1e-9);
  EXPECT_NEAR(at(Joint::kLeftHip).z() - at(Joint::kLeftKnee).z(), 0.45, 1e-9);
  wearer.forearm = 0.05;
  EXPECT_THROW(
      try { wearer_skeleton(wearer); } catch (const std::invalid_argument& error) {
        EXPECT_THAT(error.what(), HasSubstr("forearm: 0.05 m, expected 0.18"));
        throw;
      },
      std::invalid_argument);
}

}  // namespace
}  // namespace secondskin::server
