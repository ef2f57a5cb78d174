#include <gtest/gtest.h>

#include <algorithm>

#include "tests/coach_align/trials.h"

// Real motions (reference_motions/*, origins in their motion.toml) followed under time warps that
// are known, with what goes wrong in practice. The bounds are those of a listener that cues in
// time: "within 100 ms" is a reaction time's jitter. bench/align_bench prints the figures
// themselves.
namespace secondskin::coach {
namespace {

struct Result {
  std::vector<double> error;     // on moving frames that were followed [s]
  std::vector<double> recovery;  // after a pause or a skip [s]
  std::size_t moving = 0, lost = 0, inside = 0;

  double quantile(double q) const {
    std::vector<double> sorted = error;
    std::sort(sorted.begin(), sorted.end());
    return sorted[static_cast<std::size_t>(q * static_cast<double>(sorted.size() - 1))];
  }
  double mean() const {
    double sum = 0.0;
    for (const double e : error) sum += e;
    return sum / static_cast<double>(error.size());
  }
  double within(double limit) const {
    return static_cast<double>(
               std::count_if(error.begin(), error.end(), [=](double e) { return e <= limit; })) /
           static_cast<double>(error.size());
  }
};

void follow(const std::shared_ptr<const Reference>& reference, const Motion& body, const Warp& warp,
            Result& result) {
  std::vector<double> events;
  Aligner aligner(reference);
  std::size_t event = 0;
  double since = -1.0;
  for (const Frame& frame : warped(body, warp, &events)) {
    const AlignmentEstimate estimate = aligner.update(stamp(frame.time), frame.pose);
    ASSERT_GE(estimate.confidence, 0.0);
    ASSERT_LE(estimate.confidence, 1.0);
    const double error = std::fabs(estimate.reference_time - frame.truth);
    for (; event < events.size() && frame.time >= events[event]; ++event) since = events[event];
    if (since >= 0.0 && error < 0.1) {
      result.recovery.push_back(frame.time - since);
      since = -1.0;
    }
    if (frame.truth < 0.5 || frame.truth > reference->motion.duration() - 0.2) continue;
    ++result.inside;
    if (estimate.phase == Phase::kLost) ++result.lost;
    if (!frame.moving) continue;
    ++result.moving;
    if (estimate.phase == Phase::kMoving || estimate.phase == Phase::kPaused) {
      result.error.push_back(error);
    }
  }
}

Result follow_all(Warp warp, double stature = 0.0) {
  Result result;
  for (const char* name : {"low_block", "roundhouse_kick", "stepping_punch", "knife_hand_block",
                           "squat", "wave_hello"}) {
    const Motion motion = shipped_learner(name);
    const auto reference = reference_of(motion);
    const Motion body = stature > 0.0 ? fit_to(motion, canonical_skeleton(stature)) : motion;
    for (int repeat = 0; repeat < 2; ++repeat) {
      ++warp.seed;
      follow(reference, body, warp, result);
    }
  }
  EXPECT_GT(result.error.size(), 3000U);
  EXPECT_GT(static_cast<double>(result.error.size()), 0.95 * static_cast<double>(result.moving));
  EXPECT_LT(static_cast<double>(result.lost), 0.01 * static_cast<double>(result.inside));
  return result;
}

TEST(AlignerUnderAKnownWarp, IsWithinMilliseconds) {
  const Result r = follow_all({});
  EXPECT_LT(r.quantile(0.5), 0.008);
  EXPECT_LT(r.mean(), 0.015);
  EXPECT_GT(r.within(0.1), 0.99);
}

TEST(AlignerUnderAKnownWarp, ToleratesWhiteJointNoiseOfThreeDegrees) {
  const Result r = follow_all({.noise = 3.0 * kDegree});
  EXPECT_LT(r.quantile(0.5), 0.012);
  EXPECT_LT(r.mean(), 0.025);
  EXPECT_GT(r.within(0.1), 0.97);
}

TEST(AlignerUnderAKnownWarp, ToleratesSlowJointNoiseOfThreeDegrees) {
  const Result r = follow_all({.noise = 3.0 * kDegree, .noise_corner_hz = 1.0});
  EXPECT_LT(r.quantile(0.5), 0.013);
  EXPECT_LT(r.mean(), 0.028);
  EXPECT_GT(r.within(0.1), 0.95);
}

TEST(AlignerUnderAKnownWarp, ToleratesABodyOfAnotherSize) {
  const Result r = follow_all({}, 1.45);
  EXPECT_LT(r.quantile(0.5), 0.008);
  EXPECT_GT(r.within(0.1), 0.99);
}

TEST(AlignerUnderAKnownWarp, ToleratesAFifthOfTheFramesMissing) {
  const Result r = follow_all({.dropped = 0.2});
  EXPECT_LT(r.quantile(0.5), 0.010);
  EXPECT_GT(r.within(0.1), 0.98);
}

TEST(AlignerUnderAKnownWarp, ToleratesJitterOfTheStamps) {
  const Result r = follow_all({.jitter = 0.004});
  EXPECT_LT(r.quantile(0.5), 0.010);
  EXPECT_GT(r.within(0.1), 0.98);
}

TEST(AlignerUnderAKnownWarp, ToleratesMissingJoints) {
  const Result r = follow_all({.missing = {Joint::kRightShoulder, Joint::kRightElbow,
                                           Joint::kRightWrist, Joint::kLeftKnee, Joint::kHead}});
  EXPECT_LT(r.quantile(0.5), 0.010);
  EXPECT_GT(r.within(0.1), 0.97);
}

TEST(AlignerUnderAKnownWarp, IsBackWithinHalfASecondAfterAPause) {
  const Result r = follow_all({.pause = 1.0});
  ASSERT_GT(r.recovery.size(), 10U);
  EXPECT_LT(*std::max_element(r.recovery.begin(), r.recovery.end()), 0.5);
  EXPECT_GT(r.within(0.1), 0.98);
}

TEST(AlignerUnderAKnownWarp, IsBackWithinHalfASecondAfterASkip) {
  const Result r = follow_all({.skip = 1.0});
  ASSERT_GT(r.recovery.size(), 10U);
  std::vector<double> sorted = r.recovery;
  std::sort(sorted.begin(), sorted.end());
  EXPECT_LT(sorted[sorted.size() * 9 / 10], 0.5);
  EXPECT_GT(r.within(0.1), 0.97);
}

// A minute that never repeats itself: the recordings of different motions one after the other.
Motion minute() {
  Motion motion = shipped_learner("low_block");
  for (const char* name : {"squat", "wave_hello", "roundhouse_kick", "jumping_jack",
                           "stepping_punch", "knife_hand_block"}) {
    const Motion more = resample(shipped_learner(name), motion.rate_hz);
    motion.poses.insert(motion.poses.end(), more.poses.begin(), more.poses.end());
  }
  return motion;
}

TEST(Aligner, FindsALearnerWhoLeapsFarOutsideTheWindow) {
  const Motion motion = minute();
  ASSERT_GT(motion.duration(), 50.0);
  const auto reference = reference_of(motion);
  Aligner aligner(reference);
  Pose pose(kJointCount);
  double time = 0.0, error = 0.0;
  const auto play = [&](double from, double to) {
    for (double x = from; x < to; x += 1.0 / kLearnerRate, time += 1.0 / kLearnerRate) {
      sample(motion, x, pose);
      error = std::fabs(aligner.update(stamp(time), pose).reference_time - x);
    }
  };
  play(0.0, 3.0);
  ASSERT_LT(error, 0.1);
  play(22.7, 23.2);  // 20 s ahead, in the wave
  EXPECT_LT(error, 0.1);
  play(29.5, 30.0);  // 6 s ahead, in a kick
  EXPECT_LT(error, 0.1);
  play(30.0, 31.0);
  EXPECT_LT(error, 0.1);
}

// Monotone and near the best path that knows the future (full dynamic time warping).
TEST(Aligner, StaysNearTheOfflinePathOnAnotherRepetition) {
  const auto reference = shipped("low_block");
  const Motion learner = resample(slice(shipped_learner("low_block"), 0, 200), 60.0);
  const std::size_t rows = learner.poses.size(), columns = reference->motion.poses.size();
  std::vector<double> cost(rows * columns);
  const auto at = [&](std::size_t i, std::size_t j) -> double& { return cost[i * columns + j]; };
  for (std::size_t i = 0; i < rows; ++i) {
    for (std::size_t j = 0; j < columns; ++j) {
      double best = i + j == 0 ? 0.0 : 1e9;
      if (i > 0) best = std::min(best, at(i - 1, j));
      if (j > 0) best = std::min(best, at(i, j - 1));
      if (i > 0 && j > 0) best = std::min(best, at(i - 1, j - 1));
      at(i, j) = best + rms_distance(learner.poses[i], reference->motion.poses[j]);
    }
  }
  std::vector<double> path(rows);
  for (std::size_t i = rows - 1, j = columns - 1;;) {
    path[i] = static_cast<double>(j) / 60.0;
    if (i == 0) break;
    const double diagonal = j > 0 ? at(i - 1, j - 1) : 1e9, left = j > 0 ? at(i, j - 1) : 1e9;
    if (left < diagonal && left < at(i - 1, j)) {
      --j;
    } else if (diagonal <= at(i - 1, j)) {
      --i, --j;
    } else {
      --i;
    }
  }

  Aligner aligner(reference);
  std::vector<double> off;
  double furthest = 0.0, backwards = 0.0;
  for (std::size_t i = 0; i < rows; ++i) {
    const auto e = aligner.update(stamp(static_cast<double>(i) / 60.0), learner.poses[i]);
    if (e.phase != Phase::kMoving) continue;
    furthest = std::max(furthest, e.reference_time);
    backwards = std::max(backwards, furthest - e.reference_time);
    const double speed = i > 0 ? rms_distance(learner.poses[i], learner.poses[i - 1]) * 60.0 : 0.0;
    if (speed > 90.0 * kDegree) off.push_back(std::fabs(e.reference_time - path[i]));
  }
  ASSERT_GT(off.size(), 30U);
  std::sort(off.begin(), off.end());
  EXPECT_LT(off[off.size() / 2], 0.03);
  EXPECT_LT(backwards, 0.1);
}

}  // namespace
}  // namespace secondskin::coach
