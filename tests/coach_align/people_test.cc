#include <gtest/gtest.h>

#include "motion/marker_file.h"
#include "server/markers/marker_source.h"
#include "tests/coach_align/trials.h"

// People differ from the expert: in posture, in how their limbs are turned, in how far they go.
// Real people: UI-PRMD's subjects 1 and 4 (tests/data/ui_prmd) in references by its subject 2.
namespace secondskin::coach {
namespace {

struct Followed {
  int finished = 0;
  double lost = 0.0;      // share of the frames
  double furthest = 0.0;  // share of the reference
};

// The last pose is held for half a second: the files end as the people arrive.
Followed follow(const std::shared_ptr<const Reference>& reference, const Motion& learner) {
  Aligner aligner(reference);
  const Motion stream = resample(learner, kLearnerRate);
  const std::size_t n = stream.poses.size() + static_cast<std::size_t>(0.5 * kLearnerRate);
  Followed result;
  Phase before = Phase::kWaiting;
  for (std::size_t i = 0; i < n; ++i) {
    const Pose& pose = stream.poses[std::min(i, stream.poses.size() - 1)];
    const auto e = aligner.update(stamp(static_cast<double>(i) / kLearnerRate), pose);
    if (e.phase == Phase::kFinished && before != Phase::kFinished) ++result.finished;
    if (e.phase == Phase::kLost) result.lost += 1.0 / static_cast<double>(n);
    result.furthest = std::max(result.furthest, e.reference_time / reference->motion.duration());
    before = e.phase;
  }
  return result;
}

Motion from_markers(const std::string& file) {
  const std::filesystem::path source_dir = SECONDSKIN_SOURCE_DIR;
  const auto set = server::MarkerSet::load(source_dir / "marker_sets" / "plug_in_gait.toml");
  server::MarkerSource source(read_markers(source_dir / "tests" / "data" / "ui_prmd" / file), set);
  Motion motion{source.skeleton(), source.rate_hz(), {}};
  for (StampedPose pose; source.next(pose) == server::Next::kPose;) {
    motion.poses.push_back(pose.pose);
  }
  return motion;
}

// Each joint by as much, about an axis of its own; the pelvis stays.
Motion with_posture(const Motion& motion, double size, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  Motion result = motion;
  for (std::size_t j = 1; j < kJointCount; ++j) {
    const Eigen::Vector3d axis(normal(random), normal(random), normal(random));
    const Eigen::Quaterniond offset = quaternion_from(size * axis.normalized());
    for (Pose& pose : result.poses) pose.q_PB[j] = (pose.q_PB[j] * offset).normalized();
  }
  return result;
}

TEST(People, AreFollowedInSomebodyElsesSquat) {
  const Motion learner = from_markers("m01_s01_e02_positions.txt.gz");
  const auto mean = shipped("deep_squat");
  const auto one = std::make_shared<const Reference>(
      load_reference(kReferences / "deep_squat" / "motion.bvh", kJointMaps));  // all joints alike
  for (const auto& reference : {mean, one}) {
    const Followed f = follow(reference, learner);
    EXPECT_EQ(f.finished, 1) << reference->name;
    EXPECT_EQ(f.lost, 0.0);
  }
}

// Subject 4 raises the arm by 38 degrees where the expert raises it by 110: too little to be a
// repetition, but nothing else either.
TEST(People, WhoHardlyMoveAreWaitedFor) {
  const Followed f =
      follow(shipped("shoulder_abduction"), from_markers("m07_s04_e01_positions_inc.txt.gz"));
  EXPECT_EQ(f.finished, 0);
  EXPECT_EQ(f.lost, 0.0);
}

TEST(People, WithAPostureOfTheirOwnAreFollowed) {
  for (const char* name : {"deep_squat", "sit_to_stand", "shoulder_abduction", "squat"}) {
    const auto reference = shipped(name);
    for (unsigned seed = 0; seed < 5; ++seed) {
      const Followed f = follow(reference, with_posture(reference->motion, 15.0 * kDegree, seed));
      EXPECT_EQ(f.finished, 1) << name << ", seed " << seed;
      EXPECT_EQ(f.lost, 0.0) << name << ", seed " << seed;
    }
  }
}

TEST(People, WithASmallerRangeOfMotionAreFollowed) {
  for (const char* name : {"deep_squat", "sit_to_stand", "shoulder_abduction"}) {
    const auto reference = shipped(name);
    Motion learner = reference->motion;
    for (Pose& pose : learner.poses) {
      Pose part(kJointCount);
      interpolate(learner.poses.front(), pose, 0.6, part);
      pose = part;
    }
    EXPECT_EQ(follow(reference, learner).finished, 1) << name;
  }
}

}  // namespace
}  // namespace secondskin::coach
