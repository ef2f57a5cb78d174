#include "server/optical/track/body_tracker.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "ring_rig.h"

namespace secondskin::server {
namespace {

// A forearm that swings and turns, six detectors around it that all face the same way.
constexpr std::size_t kDetectors = 6;
const std::vector<std::size_t> kOneSegment(kDetectors, 0);

Eigen::Isometry3d forearm(double t) {
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  X.translation() = Eigen::Vector3d(0.2 * std::sin(3.0 * t), 0.1, 1.1 + 0.1 * std::cos(2.0 * t));
  X.linear() = (Eigen::AngleAxisd(1.2 * std::sin(2.5 * t), Eigen::Vector3d::UnitY()) *
                Eigen::AngleAxisd(0.8 * std::sin(1.5 * t), Eigen::Vector3d::UnitZ()))
                   .toRotationMatrix();
  return X;
}

Eigen::Vector3d place(std::size_t d) {
  const double angle = 1.1 * static_cast<double>(d);
  return {0.04 * std::cos(angle), 0.04 * std::sin(angle), 0.05 * static_cast<double>(d)};
}

using Sees = std::function<bool(std::uint64_t cycle, std::size_t detector, std::size_t projector)>;
using Where = std::function<Eigen::Vector3d(std::size_t detector, double t)>;
using Change = std::function<void(std::uint64_t, std::mt19937&, ProjectorFrame&)>;

Eigen::Vector3d on_forearm(std::size_t d, double t) { return forearm(t) * place(d); }

struct Result {
  double rms = 0.0, most = 0.0;
  double normalised = 0.0;  ///< mean of error^2 / residual^2
  std::vector<int> visible = std::vector<int>(kDetectors, 0);
  std::vector<double> most_of = std::vector<double>(kDetectors, 0.0);
};

template <class Tracker>
Result track(Tracker& tracker, std::uint64_t cycles, const Sees& sees,
             const Where& where = on_forearm, const Change& change = {},
             std::uint64_t count_from = 0) {
  const ProjectorRig rig = ring_rig();
  std::mt19937 random(1);
  ProjectorFrame frame(kDetectors, 16);
  MarkerFrame out;
  Result result;
  int n = 0;
  for (std::uint64_t k = 0; k < cycles; ++k) {
    for (std::size_t d = 0; d < kDetectors; ++d) {
      read_values(
          rig, [&](double t) { return where(d, t); }, k, 0.5, random, d,
          [&](std::size_t p) { return sees(k, d, p); }, frame);
    }
    if (change) change(k, random, frame);
    tracker.update(frame, out);
    if (k < count_from) continue;
    for (std::size_t d = 0; d < kDetectors; ++d) {
      if (out.visible[d] == 0) continue;
      const double e = (out.p_WM[d] - where(d, (static_cast<double>(k) + 1.0) * 0.016)).norm();
      result.rms += e * e;
      result.normalised += std::pow(e / static_cast<double>(out.residual[d]), 2);
      result.most = std::max(result.most, e);
      result.most_of[d] = std::max(result.most_of[d], e);
      ++result.visible[d];
      ++n;
    }
  }
  result.rms = std::sqrt(result.rms / std::max(1, n));
  result.normalised /= std::max(1, n);
  return result;
}

const Sees kFront = [](std::uint64_t, std::size_t, std::size_t p) { return sees_front(p); };

TEST(BodyTracker, KnowsADetectorBetterThanItsOwnValuesDo) {
  const ProjectorRig rig = ring_rig();
  BodyTracker body(rig, kOneSegment);
  DetectorTracker singles(rig, kDetectors);
  const Result together = track(body, 1000, kFront), alone = track(singles, 1000, kFront);
  EXPECT_LT(together.rms, 0.75 * alone.rms);
  EXPECT_LT(together.rms, 0.0045);
  EXPECT_LT(together.most, 0.02);
  for (const int visible : together.visible) EXPECT_GT(visible, 980);
}

TEST(BodyTracker, IsAsGoodAsItSays) {
  BodyTracker body(ring_rig(), kOneSegment);
  const Result result = track(body, 2000, kFront, on_forearm, {}, 100);
  EXPECT_GT(result.normalised, 0.4);  // careful: the model allows faster motion than this
  EXPECT_LT(result.normalised, 1.2);
}

TEST(BodyTracker, KnowsADetectorThatSeesOnePair) {
  // Two planes: no point by themselves.
  BodyTracker body(ring_rig(), kOneSegment);
  const Result result = track(body, 600, [](std::uint64_t k, std::size_t d, std::size_t p) {
    return d == 2 && k > 200 ? p < 2 : sees_front(p);
  });
  EXPECT_GT(result.visible[2], 580);
  EXPECT_LT(result.most_of[2], 0.025);
}

TEST(BodyTracker, GivesNoPointThatWasNotMeasured) {
  BodyTracker body(ring_rig(), kOneSegment);
  const Result result = track(body, 600, [](std::uint64_t k, std::size_t d, std::size_t p) {
    return !(d == 2 && k >= 200) && sees_front(p);
  });
  EXPECT_LE(result.visible[2], 200);
  EXPECT_GT(result.visible[3], 580);
}

TEST(BodyTracker, IsNotMisledByADetectorOfAnotherLimb) {
  // Swapped in the configuration: it moves quite otherwise.
  BodyTracker body(ring_rig(), kOneSegment);
  const Where where = [](std::size_t d, double t) -> Eigen::Vector3d {
    if (d != 4) return on_forearm(d, t);
    return {-0.3 + 0.2 * std::cos(2.0 * t), 0.25 * std::sin(3.1 * t), 0.9};
  };
  const Result result = track(body, 1000, kFront, where);
  for (std::size_t d = 0; d < kDetectors; ++d) {
    EXPECT_LT(result.most_of[d], 0.04) << d;
    EXPECT_GT(result.visible[d], d == 4 ? 300 : 800) << d;
  }
  EXPECT_FALSE(body.placed(4));
  EXPECT_TRUE(body.placed(3));
}

TEST(BodyTracker, FollowsADetectorThatSlips) {
  // 5 cm along the arm within a cycle, then it stays there.
  BodyTracker body(ring_rig(), kOneSegment);
  const Where where = [](std::size_t d, double t) -> Eigen::Vector3d {
    const bool slipped = d == 1 && t > 400.01 * 0.016;
    return forearm(t) * (place(d) + Eigen::Vector3d(0.0, 0.0, slipped ? 0.05 : 0.0));
  };
  const Result result = track(body, 800, kFront, where);
  EXPECT_LT(result.most, 0.03);
  EXPECT_GT(result.visible[1], 760);
}

TEST(BodyTracker, GivesNoWrongPointWhereSetsAreTornAndValuesWild) {
  BodyTracker body(ring_rig(), kOneSegment);
  const Result result = track(body, 1500, kFront, on_forearm,
                              [](std::uint64_t, std::mt19937& random, ProjectorFrame& frame) {
                                const bool torn = random() % 10 == 0;
                                for (auto& value : frame.values) {
                                  if ((torn || random() % 50 == 0) && value != 0) {
                                    value = static_cast<std::uint8_t>(1 + random() % 254);
                                  }
                                }
                              });
  EXPECT_LT(result.most, 0.03);
  for (const int visible : result.visible) EXPECT_GT(visible, 1000);
}

TEST(BodyTracker, KeepsOnWhenAProjectorGoesDark) {
  BodyTracker body(ring_rig(), kOneSegment);
  const Result result = track(body, 600, [](std::uint64_t k, std::size_t, std::size_t p) {
    return sees_front(p) && !(p == 0 && k >= 200);
  });
  EXPECT_LT(result.most, 0.03);
  for (const int visible : result.visible) EXPECT_GT(visible, 560);
  EXPECT_LE(body.projector_fits()[0].used + body.projector_fits()[0].gated, 240U * kDetectors);
}

TEST(BodyTracker, TracksFewDetectorsOfASegmentByThemselves) {
  const ProjectorRig rig = ring_rig();
  const std::vector<std::size_t> segments{0, 0, 1, 1, 2, 3};
  BodyTracker body(rig, segments);
  DetectorTracker singles(rig, kDetectors);
  const Result a = track(body, 200, kFront), b = track(singles, 200, kFront);
  EXPECT_EQ(a.rms, b.rms);
  EXPECT_EQ(a.visible, b.visible);
}

TEST(BodyTracker, PredictsOverLostCyclesAndBeginsAnewWhenTheyDo) {
  const ProjectorRig rig = ring_rig();
  BodyTracker body(rig, kOneSegment);
  std::mt19937 random(1);
  ProjectorFrame frame(kDetectors, 16);
  MarkerFrame out;
  int visible = 0;
  for (std::uint64_t k = 0; k < 400; ++k) {
    for (std::size_t d = 0; d < kDetectors; ++d) {
      read_values(
          rig, [&](double t) { return on_forearm(d, t); }, k, 0.5, random, d, sees_front, frame);
    }
    if (k > 50 && random() % 3 == 0) continue;
    body.update(frame, out);
    for (std::size_t d = 0; d < kDetectors; ++d) {
      if (out.visible[d] == 0) continue;
      ++visible;
      EXPECT_LT((out.p_WM[d] - on_forearm(d, (static_cast<double>(k) + 1.0) * 0.016)).norm(), 0.03);
    }
  }
  EXPECT_GT(visible, 250 * static_cast<int>(kDetectors));
  frame.cycle = 0;
  body.update(frame, out);
  for (const auto v : out.visible) EXPECT_EQ(v, 0);
}

TEST(BodyTracker, TakesAFrameOfAnotherSizeForALostOne) {
  BodyTracker body(ring_rig(), kOneSegment);
  track(body, 50, kFront);
  ProjectorFrame frame(3, 16);
  frame.cycle = 50;
  MarkerFrame out;
  body.update(frame, out);
  ASSERT_EQ(out.visible.size(), kDetectors);
  for (const auto v : out.visible) EXPECT_EQ(v, 0);
}

}  // namespace
}  // namespace secondskin::server
