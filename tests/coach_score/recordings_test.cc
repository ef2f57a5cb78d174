#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <string>
#include <vector>

#include "coach/score/offline.h"
#include "motion/retarget.h"

/// Real executions of exercises (reference_motions/*/motion.toml say whose): three right ones, and
/// three wrong ones in learner.bvh.
namespace secondskin::coach {
namespace {

const std::filesystem::path kReferences =
    std::filesystem::path(SECONDSKIN_SOURCE_DIR) / "reference_motions";
const std::filesystem::path kJointMaps =
    std::filesystem::path(SECONDSKIN_SOURCE_DIR) / "joint_maps";

std::vector<StampedPose> stamped(const Motion& motion) {
  std::vector<StampedPose> poses;
  for (std::size_t i = 0; i < motion.poses.size(); ++i) {
    const double t = 1.0 + static_cast<double>(i) / motion.rate_hz;
    poses.push_back({i, static_cast<std::int64_t>(t * 1e9), motion.poses[i]});
  }
  return poses;
}

double total(const std::shared_ptr<const Reference>& reference, const Motion& motion) {
  const OfflineScore score = score_whole(reference, stamped(motion));
  EXPECT_EQ(score.repetitions.size(), 1U);
  return score.repetitions.empty() ? std::nan("") : score.repetitions[0].total;
}

struct Recording {
  std::string name;
  std::vector<std::array<std::size_t, 2>> wrong;  // where in learner.bvh, half a second apart
};
const std::vector<Recording> kRecordings{{"deep_squat", {{0, 301}, {350, 650}, {699, 1009}}},
                                         {"sit_to_stand", {{0, 462}, {511, 957}, {1006, 1439}}}};

Motion read(const Recording& recording, const std::string& file) {
  return read_canonical(kReferences / recording.name / file, kJointMaps);
}

// Each right one against the other two.
TEST(Score, PutsWrongExecutionsBelowRightOnes) {
  for (const Recording& recording : kRecordings) {
    const Reference shipped = load_reference(kReferences / recording.name, kJointMaps);
    std::vector<Motion> right;
    for (const char* file : {"motion.bvh", "expert_2.bvh", "expert_3.bvh"}) {
      right.push_back(read(recording, file));
    }
    double worst_right = 100.0;
    for (std::size_t i = 0; i < right.size(); ++i) {
      std::vector<Motion> others;
      for (std::size_t k = 0; k < right.size(); ++k) {
        if (k != i) others.push_back(right[k]);
      }
      Reference reference = make_reference(recording.name, others);
      reference.weight = shipped.weight;
      reference.tolerance = shipped.tolerance;
      worst_right =
          std::min(worst_right, total(std::make_shared<const Reference>(reference), right[i]));
    }
    EXPECT_GT(worst_right, 80.0) << recording.name;
    const auto all = std::make_shared<const Reference>(shipped);
    const Motion learner = read(recording, "learner.bvh");
    for (const auto& [begin, end] : recording.wrong) {
      const double wrong = total(all, slice(learner, begin, end));
      EXPECT_LT(wrong, worst_right) << recording.name << " from frame " << begin;
      EXPECT_GT(wrong, 0.0);
    }
  }
}

TEST(Score, IsTheSameForABodyOfAnotherSize) {
  const Recording& recording = kRecordings.front();
  const auto reference =
      std::make_shared<const Reference>(load_reference(kReferences / recording.name, kJointMaps));
  const Motion learner = slice(read(recording, "learner.bvh"), 0, 301);
  EXPECT_NEAR(total(reference, fit_to(learner, canonical_skeleton(1.4))), total(reference, learner),
              1e-6);
}

TEST(Score, TakesTheBetterSideWhereEitherIsFine) {
  const Motion right =
      read_canonical(kReferences / "shoulder_abduction" / "expert_2.bvh", kJointMaps);
  Motion left = right;
  for (Pose& pose : left.poses) pose = mirrored(pose);
  Reference reference = load_reference(kReferences / "shoulder_abduction", kJointMaps);
  EXPECT_TRUE(reference.either_side);
  const auto either = std::make_shared<const Reference>(reference);
  const OfflineScore one = score_whole(either, stamped(right));
  const OfflineScore other = score_whole(either, stamped(left));
  ASSERT_EQ(one.repetitions.size(), 1U);
  ASSERT_EQ(other.repetitions.size(), 1U);
  EXPECT_FALSE(one.mirrored);
  EXPECT_TRUE(other.mirrored);
  EXPECT_NEAR(one.repetitions[0].total, other.repetitions[0].total, 0.01);
  reference.either_side = false;
  EXPECT_LT(total(std::make_shared<const Reference>(reference), left),
            one.repetitions[0].total - 10.0);
}

}  // namespace
}  // namespace secondskin::coach
