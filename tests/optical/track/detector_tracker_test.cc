#include "server/optical/track/detector_tracker.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>

#include "ring_rig.h"

namespace secondskin::server {
namespace {

constexpr double kCycle = 0.016;

double end_of(std::uint64_t cycle) { return (static_cast<double>(cycle) + 1.0) * kCycle; }

// A hand that waves about: up to 1.3 m/s.
Eigen::Vector3d wave(double t) {
  return {0.3 * std::sin(4.0 * t), 0.2 * std::cos(3.0 * t), 1.1 + 0.1 * std::sin(5.0 * t)};
}

struct Errors {
  double rms = 0.0, most = 0.0;
  int visible = 0;
};

template <class Change>
Errors track(const ProjectorRig& rig, DetectorTracker& tracker, std::uint64_t cycles,
             const Change& change, unsigned seed = 1) {
  std::mt19937 random(seed);
  ProjectorFrame frame(1, 16);
  MarkerFrame out;
  Errors errors;
  double squares = 0.0;
  for (std::uint64_t k = 0; k < cycles; ++k) {
    read_values(rig, wave, k, 0.5, random, 0, sees_front, frame);
    change(k, random, frame);
    tracker.update(frame, out);
    if (out.visible[0] == 0) continue;
    const double e = (out.p_WM[0] - wave(end_of(k))).norm();
    squares += e * e;
    errors.most = std::max(errors.most, e);
    ++errors.visible;
  }
  errors.rms = std::sqrt(squares / std::max(1, errors.visible));
  return errors;
}

const auto kAsItIs = [](std::uint64_t, std::mt19937&, ProjectorFrame&) {};

TEST(DetectorTracker, GivesThePointAtTheEndOfTheCycleWithoutDelay) {
  const ProjectorRig rig = ring_rig();
  DetectorTracker tracker(rig, 1);
  const Errors errors = track(rig, tracker, 500, kAsItIs);
  EXPECT_GT(errors.visible, 480);
  EXPECT_LT(errors.rms, 0.007);
  EXPECT_LT(errors.most, 0.025);
}

TEST(DetectorTracker, IsReportedOnlyAfterThreeFurtherCyclesThatAgree) {
  const ProjectorRig rig = ring_rig();
  DetectorTracker tracker(rig, 1, {.visible_sigma = 0.05});
  std::mt19937 random(1);
  ProjectorFrame frame(1, 16);
  MarkerFrame out;
  for (std::uint64_t k = 0; k < 6; ++k) {
    read_values(rig, wave, k, 0.5, random, 0, sees_front, frame);
    tracker.update(frame, out);
    EXPECT_EQ(out.visible[0], k >= 3 ? 1 : 0) << k;
  }
}

TEST(DetectorTracker, NeedsTheSlotsTimes) {
  // Up to 2 m/s, seen by the first six projectors: on average 5 ms before the cycle's middle.
  const ProjectorRig rig = ring_rig();
  const auto path = [](double t) { return Eigen::Vector3d(0.1, 0.4 * std::sin(5.0 * t), 1.0); };
  const auto rms = [&](bool slot_times) {
    DetectorTracker tracker(rig, 1, {.visible_sigma = 0.02, .slot_times = slot_times});
    std::mt19937 random(1);
    ProjectorFrame frame(1, 16);
    MarkerFrame out;
    double squares = 0.0;
    int n = 0;
    for (std::uint64_t k = 0; k < 500; ++k) {
      read_values(
          rig, path, k, 0.5, random, 0, [](std::size_t p) { return p < 6; }, frame);
      tracker.update(frame, out);
      if (out.visible[0] == 0) continue;
      squares += (out.p_WM[0] - path(end_of(k))).squaredNorm();
      ++n;
    }
    return std::sqrt(squares / n);
  };
  EXPECT_LT(1.2 * rms(true), rms(false));
}

TEST(DetectorTracker, IsAsGoodAsItSays) {
  // Normalised estimation error squared over independent runs of motion as the model has it; both
  // models alike, so that this is a plain Kalman filter. 9 degrees of freedom, 3 of the position.
  const ProjectorRig rig = ring_rig();
  const Manoeuvre manoeuvre{5.0, 0.3};  // some 20 cm in these 0.48 s
  TrackerOptions options{.calm = manoeuvre, .brisk = manoeuvre, .visible_sigma = 1.0};
  options.noise.model_sigma = 0.0;
  double position = 0.0, whole = 0.0;
  constexpr int kRuns = 400;
  int n = 0;
  for (int run = 0; run < kRuns; ++run) {
    std::mt19937 random(static_cast<unsigned>(run));
    std::normal_distribution<double> normal;
    // The true motion in steps of 0.1 ms; it starts still and near the middle.
    constexpr double kStep = 1e-4;
    std::vector<Eigen::Matrix<double, 9, 1>> truth(1, Eigen::Matrix<double, 9, 1>::Zero());
    truth[0].segment<3>(0) = Eigen::Vector3d(0.1, 0.0, 1.0);
    for (int i = 0; i < 30 * 160; ++i) {
      Eigen::Matrix<double, 9, 1> x = truth.back();
      x.segment<3>(0) += kStep * x.segment<3>(3);
      x.segment<3>(3) += kStep * x.segment<3>(6);
      x.segment<3>(6) *= 1.0 - kStep / manoeuvre.memory;
      for (int axis = 0; axis < 3; ++axis) {
        x[6 + axis] += manoeuvre.jerk * std::sqrt(kStep) * normal(random);
      }
      truth.push_back(x);
    }
    const auto path = [&](double t) -> Eigen::Vector3d {
      return truth[static_cast<std::size_t>(std::lround(t / kStep))].head<3>();
    };
    DetectorTracker tracker(rig, 1, options);
    ProjectorFrame frame(1, 16);
    MarkerFrame out;
    for (std::uint64_t k = 0; k < 30; ++k) {
      read_values(rig, path, k, 0.5, random, 0, sees_front, frame);
      tracker.update(frame, out);
    }
    const auto estimate = tracker.confirmed(0);
    if (!estimate) continue;  // of a cycle with several unlikely values
    ++n;
    const Eigen::Matrix<double, 9, 1> e = estimate->state() - truth.back();
    position += e.head<3>().dot(estimate->P_pp.inverse() * e.head<3>());
    whole += e.dot(estimate->covariance().inverse() * e);
  }
  EXPECT_GT(n, 380);
  position /= n;
  whole /= n;
  // Standard deviations of the means: sqrt(2 n / runs) = 0.12 and 0.21. The filter doubts some
  // values that are right, so it errs on the careful side.
  EXPECT_GT(position, 2.4);
  EXPECT_LT(position, 3.4);
  EXPECT_GT(whole, 7.5);
  EXPECT_LT(whole, 9.7);
}

TEST(DetectorTracker, DoesNotKnowTheFuture) {
  const ProjectorRig rig = ring_rig();
  DetectorTracker a(rig, 1), b(rig, 1);
  std::mt19937 random(1), other(2);
  ProjectorFrame frame(1, 16);
  MarkerFrame out_a, out_b;
  for (std::uint64_t k = 0; k < 50; ++k) {
    read_values(rig, wave, k, 0.5, random, 0, sees_front, frame);
    a.update(frame, out_a);
    b.update(frame, out_b);
    EXPECT_EQ(out_a.p_WM[0], out_b.p_WM[0]);
  }
  read_values(rig, wave, 50, 0.5, other, 0, sees_front, frame);
  b.update(frame, out_b);
  EXPECT_NE(out_a.p_WM[0], out_b.p_WM[0]);
}

TEST(DetectorTracker, TreatsEveryDetectorAlike) {
  const ProjectorRig rig = ring_rig();
  const std::vector<std::size_t> order{2, 0, 3, 1};
  DetectorTracker straight(rig, 4), permuted(rig, 4);
  std::mt19937 random(3);
  ProjectorFrame frame(4, 16), other(4, 16);
  MarkerFrame out, out_other;
  for (std::uint64_t k = 0; k < 50; ++k) {
    for (std::size_t d = 0; d < 4; ++d) {
      const Eigen::Vector3d offset(0.1 * static_cast<double>(d), 0.0, 0.0);
      read_values(
          rig, [&](double t) -> Eigen::Vector3d { return wave(t) + offset; }, k, 0.5, random, d,
          sees_front, frame);
    }
    other.cycle = frame.cycle;
    other.stamp_ns = frame.stamp_ns;
    for (std::size_t d = 0; d < 4; ++d) {
      std::copy_n(&frame.values[order[d] * 16], 16, &other.values[d * 16]);
    }
    straight.update(frame, out);
    permuted.update(other, out_other);
    for (std::size_t d = 0; d < 4; ++d) {
      EXPECT_EQ(out_other.p_WM[d], out.p_WM[order[d]]);
      EXPECT_EQ(out_other.visible[d], out.visible[order[d]]);
    }
  }
}

TEST(DetectorTracker, IsNotMovedByWildValues) {
  const ProjectorRig rig = ring_rig();
  DetectorTracker tracker(rig, 1);
  const Errors errors =
      track(rig, tracker, 1500, [](std::uint64_t, std::mt19937& random, ProjectorFrame& frame) {
        for (auto& value : frame.values) {
          if (value != 0 && random() % 20 == 0)
            value = static_cast<std::uint8_t>(1 + random() % 254);
        }
      });
  EXPECT_GT(errors.visible, 1300);
  EXPECT_LT(errors.rms, 0.008);
  EXPECT_LT(errors.most, 0.035);
  EXPECT_GT(tracker.detector_counts()[0].gated, 300U);
}

TEST(DetectorTracker, GivesNoPointOfATornSet) {
  // What should never pass the decoder: all values of a set are others'.
  const ProjectorRig rig = ring_rig();
  DetectorTracker tracker(rig, 1);
  const Errors errors =
      track(rig, tracker, 1500, [](std::uint64_t, std::mt19937& random, ProjectorFrame& frame) {
        if (random() % 10 != 0) return;
        for (auto& value : frame.values) value = static_cast<std::uint8_t>(1 + random() % 254);
      });
  EXPECT_GT(errors.visible, 1000);
  EXPECT_LT(errors.most, 0.035);
}

TEST(DetectorTracker, PredictsOverADropOut) {
  const ProjectorRig rig = ring_rig();
  DetectorTracker tracker(rig, 1);
  std::uint64_t seen_again = 0;
  const Errors errors =
      track(rig, tracker, 300, [&](std::uint64_t k, std::mt19937&, ProjectorFrame& frame) {
        if (k % 60 >= 50) std::fill(frame.values.begin(), frame.values.end(), wire::kNoValue);
        seen_again = k;
      });
  EXPECT_GT(errors.visible, 200);
  EXPECT_LE(errors.visible, 250);  // never where nothing was measured
  EXPECT_LT(errors.most, 0.03);
}

TEST(DetectorTracker, PredictsOverLostCycles) {
  const ProjectorRig rig = ring_rig();
  DetectorTracker tracker(rig, 1);
  std::mt19937 random(1);
  ProjectorFrame frame(1, 16);
  MarkerFrame out;
  int visible = 0;
  for (std::uint64_t k = 0; k < 400; ++k) {
    read_values(rig, wave, k, 0.5, random, 0, sees_front, frame);
    if (k > 20 && random() % 3 == 0) continue;
    tracker.update(frame, out);
    if (out.visible[0] == 0) continue;
    ++visible;
    EXPECT_LT((out.p_WM[0] - wave(end_of(k))).norm(), 0.03);
  }
  EXPECT_GT(visible, 240);
}

TEST(DetectorTracker, BeginsAnewWhenTheCyclesDo) {
  const ProjectorRig rig = ring_rig();
  DetectorTracker tracker(rig, 1);
  track(rig, tracker, 100, kAsItIs);
  std::mt19937 random(1);
  ProjectorFrame frame(1, 16);
  MarkerFrame out;
  read_values(rig, wave, 0, 0.5, random, 0, sees_front, frame);
  tracker.update(frame, out);
  EXPECT_EQ(out.visible[0], 0);
}

TEST(DetectorTracker, FindsADetectorThatIsElsewhereAndGivesNoPointBetween) {
  // Two tags swapped: from one cycle to the next it is 40 cm away.
  const ProjectorRig rig = ring_rig();
  DetectorTracker tracker(rig, 1);
  std::mt19937 random(1);
  ProjectorFrame frame(1, 16);
  MarkerFrame out;
  const Eigen::Vector3d here(0.2, 0.0, 1.0), there(-0.2, 0.1, 1.1);
  std::uint64_t found = 0;
  for (std::uint64_t k = 0; k < 100; ++k) {
    const auto path = [&](double) { return k < 50 ? here : there; };
    read_values(rig, path, k, 0.5, random, 0, sees_front, frame);
    tracker.update(frame, out);
    if (out.visible[0] == 0) continue;
    EXPECT_LT((out.p_WM[0] - path(0.0)).norm(), 0.03) << k;
    if (k >= 50 && found == 0) found = k;
  }
  EXPECT_GE(found, 53U);
  EXPECT_LE(found, 62U);
}

TEST(DetectorTracker, ShowsADarkAndAMovedProjector) {
  const ProjectorRig rig = ring_rig();
  ProjectorRig believed = rig;
  believed.projectors[3]->P(0, 3) += 15.0;
  DetectorTracker tracker(believed, 1);
  const Errors errors =
      track(rig, tracker, 600, [](std::uint64_t k, std::mt19937&, ProjectorFrame& frame) {
        if (k >= 100) frame.values[1] = wire::kNoValue;
      });
  EXPECT_GT(errors.visible, 300);
  EXPECT_LT(errors.most, 0.05);
  const auto fits = tracker.projector_fits();
  EXPECT_LE(fits[1].used + fits[1].gated, 103U);
  EXPECT_GT(fits[3].gated, 5 * fits[3].used);
  for (const std::size_t p : {0U, 2U, 14U, 15U}) EXPECT_LT(fits[p].gated, fits[p].used / 10) << p;
}

TEST(DetectorTracker, TakesAFrameOfAnotherSizeForALostOne) {
  const ProjectorRig rig = ring_rig();
  DetectorTracker tracker(rig, 1);
  track(rig, tracker, 50, kAsItIs);
  MarkerFrame out;
  for (const auto& [detectors, projectors] : {std::pair{0, 0}, {1, 15}, {2, 16}}) {
    ProjectorFrame frame(static_cast<std::size_t>(detectors), static_cast<std::size_t>(projectors));
    frame.cycle = 50;
    tracker.update(frame, out);
    ASSERT_EQ(out.visible.size(), 1U);
    EXPECT_EQ(out.visible[0], 0);
  }
}

TEST(DetectorTracker, LeavesOutProjectorsThatAreNotCalibrated) {
  const ProjectorRig rig = ring_rig();
  ProjectorRig partly = rig;
  partly.projectors[0].reset();
  DetectorTracker tracker(partly, 1);
  const Errors errors = track(rig, tracker, 300, kAsItIs);
  EXPECT_GT(errors.visible, 150);
  EXPECT_LT(errors.most, 0.035);
  EXPECT_EQ(tracker.projector_fits()[0].used, 0U);
}

TEST(DetectorTracker, RefusesWhatIsOutOfRange) {
  ProjectorRig rig = ring_rig();
  EXPECT_THROW(DetectorTracker(rig, 1, {.stay = 1.0}), std::invalid_argument);
  EXPECT_THROW(DetectorTracker(rig, 1, {.visible_sigma = 0.0}), std::invalid_argument);
  EXPECT_THROW(DetectorTracker(rig, 1, {.noise = {.gate = 0.0}}), std::invalid_argument);
  EXPECT_THROW(DetectorTracker(rig, 1, {.noise = {.count_sigma = -1.0}}), std::invalid_argument);
  rig.projectors[5]->P(0, 0) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(DetectorTracker(rig, 1), std::invalid_argument);
}

}  // namespace
}  // namespace secondskin::server
