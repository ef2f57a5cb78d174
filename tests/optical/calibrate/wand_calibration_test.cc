#include "server/optical/calibrate/wand_calibration.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>
#include <stdexcept>

#include "tests/optical/calibrate/synthetic.h"

namespace secondskin::server {
namespace {

using test::WavedWand;
using testing::HasSubstr;

const std::vector<Eigen::Vector3d> kSquare{{0.0, 0.0, 0.03}, {0.5, 0.0, 0.03}, {0.0, 0.35, 0.03}};
const std::vector<Eigen::Vector3d> kStick{{0.0, 0.0, 0.03}, {0.6, 0.0, 0.03}};

// Projectors whose fields reach the floor in the middle.
std::vector<Projector> rig_over_floor() { return test::make_rig(16, 4); }

void wave(WandSession& session, const std::vector<Projector>& rig, const WavedWand& wand,
          double seconds, double from = 0.0) {
  std::mt19937 random(17);
  const double cycle = 1e-9 * static_cast<double>(wire::cycle_ns(rig.size()));
  for (auto k = static_cast<std::uint64_t>(from / cycle);
       static_cast<double>(k) * cycle < from + seconds; ++k) {
    session.add(
        test::wave_cycle(rig, wand, k, static_cast<double>(k) * cycle, {0.5, 0.02}, random));
  }
}

// Where the rig's projectors stand, by a tape measure: some 0.2 m and 10 degrees wrong.
RoughLayout rough_layout(const std::vector<Projector>& rig) {
  std::mt19937 random(23);
  std::normal_distribution<double> normal;
  const auto some = [&](double sigma) {
    return Eigen::Vector3d(sigma * normal(random), sigma * normal(random), sigma * normal(random));
  };
  RoughLayout layout;
  for (std::size_t i = 0; i < rig.size(); ++i) {
    layout.places.push_back(
        {test::centre_near(rig[i], {0.0, 0.0, 1.0}) + some(0.1),
         Eigen::Vector3d(0.0, 0.0, 0.95) + some(0.2),
         test::radians(45.0 + (i % 2 == 0 ? 0.0 : 90.0) + 8.0 * normal(random))});
  }
  // centre_near() gives the point of the projector's line nearest to the middle; the true one is
  // on the circle.
  for (auto& place : layout.places) {
    place.p_W.head<2>() *= 3.35 / place.p_W.head<2>().norm();
    place.p_W.z() = 1.3;
  }
  return layout;
}

TEST(WandCalibration, NeedsNoGuessWithThreeDetectors) {
  const auto rig = rig_over_floor();
  WandSession session({kSquare}, rig.size());
  wave(session, rig, WavedWand(kSquare), 45.0);
  EXPECT_EQ(session.progress().lay_downs, 1U);
  const auto result = session.solve();
  ASSERT_TRUE(result) << result.error().text;
  // The shape, and the world too: the floor comes from one lay-down of half a metre.
  EXPECT_LT(test::rig_error(rig, result->rig, true), 2e-3);
  EXPECT_LT(test::rig_error(rig, result->rig, false), 6e-3);
  EXPECT_LT(result->length_error, 3e-3);
  EXPECT_LT(result->floor_rms, 1e-3);
  for (const WandProjector& p : result->projectors) {
    EXPECT_FALSE(p.refused);
    EXPECT_GT(p.fitting, 0.97);
    EXPECT_LT(p.residual, 0.5);
  }
}

TEST(WandCalibration, PredictsItsOwnError) {
  const auto rig = rig_over_floor();
  double square = 0.0, predicted = 0.0;
  for (unsigned seed = 1; seed <= 3; ++seed) {
    WandSession session({kSquare}, rig.size());
    wave(session, rig, WavedWand(kSquare, seed), 25.0);
    const auto result = session.solve();
    ASSERT_TRUE(result) << result.error().text;
    square += std::pow(test::rig_error(rig, result->rig, true), 2) / 3.0;
    predicted += result->predicted_error / 3.0;
  }
  EXPECT_LT(std::sqrt(square), 3.0 * predicted);
  EXPECT_GT(std::sqrt(square), predicted / 3.0);
}

TEST(WandCalibration, TakesTwoDetectorsWithALayoutAndThreeLayDowns) {
  const auto rig = rig_over_floor();
  WandSettings settings;
  settings.layout = rough_layout(rig);
  WandSession session({kStick}, rig.size(), settings);
  wave(session, rig, WavedWand(kStick, 3, {{20.0, {0.3, -0.3}, 1.5}, {40.0, {-0.4, 0.2}, 2.5}}),
       48.0);
  EXPECT_EQ(session.progress().lay_downs, 3U);
  const auto result = session.solve();
  ASSERT_TRUE(result) << result.error().text;
  EXPECT_LT(test::rig_error(rig, result->rig, true), 2.5e-3);
  EXPECT_LT(test::rig_error(rig, result->rig, false), 8e-3);
}

TEST(WandCalibration, DoesNotGuessTheMirrorImage) {
  const auto rig = rig_over_floor();
  WandSession session({kStick}, rig.size());
  wave(session, rig, WavedWand(kStick), 25.0);
  const auto result = session.solve();
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().kind, RefusalKind::kMirror);
}

TEST(WandCalibration, AsksForTheFloor) {
  const auto rig = rig_over_floor();
  WandSession session({kSquare}, rig.size());
  wave(session, rig, WavedWand(kSquare), 25.0, 2.5);
  EXPECT_EQ(session.progress().lay_downs, 0U);
  const auto result = session.solve();
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().kind, RefusalKind::kNoFloor);
}

TEST(WandCalibration, NamesTheWandsDetectorsThatWereExchanged) {
  const auto rig = rig_over_floor();
  WandSession session({{kSquare[0], kSquare[2], kSquare[1]}}, rig.size());
  wave(session, rig, WavedWand(kSquare), 25.0);
  const auto result = session.solve();
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().kind, RefusalKind::kExchanged);
  EXPECT_THAT(result.error().text, HasSubstr("1 and 2 seem to be exchanged"));
}

TEST(WandCalibration, LeavesOutAndNamesADarkProjectorAndOneThatWasMoved) {
  const auto rig = rig_over_floor();
  auto moved = rig;
  moved[5] = test::make_projector(test::centre_near(rig[5], {0.0, 0.0, 1.0}), {0.3, 0.2, 1.2},
                                  test::radians(120.0));
  WandSession session({kSquare}, rig.size());
  const WavedWand wand(kSquare);
  std::mt19937 random(17);
  for (std::uint64_t k = 0; k < 2200; ++k) {
    auto frame = test::wave_cycle(k < 1100 ? rig : moved, wand, k, 0.016 * static_cast<double>(k),
                                  {0.5, 0.02}, random);
    for (std::size_t d = 0; d < 3; ++d) frame.values[d * 16 + 12] = wire::kNoValue;
    session.add(frame);
  }
  const auto result = session.solve();
  ASSERT_TRUE(result) << result.error().text;
  EXPECT_FALSE(result->rig.projectors[5]);
  ASSERT_TRUE(result->projectors[5].refused);
  EXPECT_EQ(result->projectors[5].refused->kind, RefusalKind::kDoesNotFit);
  EXPECT_FALSE(result->rig.projectors[12]);
  ASSERT_TRUE(result->projectors[12].refused);
  EXPECT_THAT(result->projectors[12].refused->text, HasSubstr("no values at all"));
  EXPECT_THAT(result->wishes, testing::Contains(HasSubstr("projector 5 is not calibrated")));
  EXPECT_THAT(result->wishes, testing::Contains(HasSubstr("projector 12 is not calibrated")));
  EXPECT_FALSE(result->enough());
  EXPECT_LT(test::rig_error(rig, result->rig, true), 3e-3);
}

TEST(WandCalibration, RefusesTooLittleAndTooFlat) {
  const auto rig = rig_over_floor();
  WandSession empty({kSquare}, rig.size());
  ASSERT_FALSE(empty.solve());
  EXPECT_EQ(empty.solve().error().kind, RefusalKind::kTooFewPoints);

  WandSession brief({kSquare}, rig.size());
  wave(brief, rig, WavedWand(kSquare), 1.5);
  ASSERT_FALSE(brief.solve());

  // It never leaves the floor.
  WandSession flat({kSquare}, rig.size());
  wave(flat, rig, WavedWand(kSquare, 3, {}, 0.0), 20.0);
  const auto result = flat.solve();
  ASSERT_FALSE(result);
  EXPECT_THAT(result.error().kind,
              testing::AnyOf(RefusalKind::kDegenerate, RefusalKind::kDoesNotFit));
}

TEST(WandCalibration, ShowsWhichFieldsAreSwept) {
  const auto rig = rig_over_floor();
  WandSession session({kSquare}, rig.size());
  std::vector<double> shares;
  const WavedWand wand(kSquare);
  for (double t = 0.0; t < 30.0; t += 10.0) {
    wave(session, rig, wand, 10.0, t);
    double least = 1.0;
    for (const auto& p : session.progress().projectors) least = std::min(least, p.share());
    shares.push_back(least);
  }
  EXPECT_LE(shares[0], shares[1]);
  EXPECT_LE(shares[1], shares[2]);
  EXPECT_GT(shares[2], 0.5);
}

TEST(WandCalibration, RefusesAWandThatIsNone) {
  EXPECT_THROW(WandSession({{kSquare[0]}}, 16), std::invalid_argument);
  EXPECT_THROW(WandSession({{kSquare[0], kSquare[0]}}, 16), std::invalid_argument);
  WandSettings settings;
  settings.layout.emplace();
  EXPECT_THROW(WandSession({kSquare}, 16, settings), std::invalid_argument);
  WandSession session({kSquare}, 16);
  EXPECT_THROW(session.add(ProjectorFrame(2, 16)), std::invalid_argument);
}

}  // namespace
}  // namespace secondskin::server
