#include "coach/reference.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>

#include "motion/bvh.h"
#include "tests/coach_align/trials.h"

namespace secondskin::coach {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
namespace fs = std::filesystem;

class ReferenceFolder : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / ("secondskin_reference_" + std::to_string(::getpid()));
    fs::remove_all(folder_);
    fs::create_directories(folder_);
    fs::copy(kReferences / "squat" / "motion.bvh", folder_ / "motion.bvh");
  }
  void TearDown() override { fs::remove_all(folder_); }

  Reference load(const std::string& toml) {
    std::ofstream(folder_ / "motion.toml") << toml;
    return load_reference(folder_, kJointMaps);
  }
  std::string complaint(const std::string& toml) {
    try {
      load(toml);
    } catch (const std::runtime_error& e) {
      return e.what();
    }
    return "no complaint";
  }

  fs::path folder_;
};

TEST(ReferenceMotions, AllLoadWithTheirOriginAndLicence) {
  int references = 0;
  for (const auto& entry : fs::directory_iterator(kReferences)) {
    if (!entry.is_directory()) continue;
    const Reference r = load_reference(entry.path(), kJointMaps);
    EXPECT_EQ(r.name, entry.path().filename());
    EXPECT_FALSE(r.description.empty());
    EXPECT_FALSE(r.origin.empty());
    EXPECT_FALSE(r.licence.empty());
    EXPECT_TRUE(fs::exists(entry.path() / "LICENCE.txt"));
    EXPECT_TRUE(fs::exists(entry.path() / "learner.bvh"));
    EXPECT_EQ(r.motion.rate_hz, kReferenceRate);
    EXPECT_TRUE(is_canonical(r.motion.skeleton));
    EXPECT_GT(r.motion.duration(), 1.0);
    EXPECT_LT(r.motion.duration(), 10.0);
    ++references;
  }
  EXPECT_GE(references, 5);
}

TEST_F(ReferenceFolder, GivesDefaultsToWhatIsNotNamed) {
  const Reference r =
      load("[weights]\ndefault = 0.5\nleft_knee = 1\n[tolerances_deg]\nhead = 25.0\n");
  EXPECT_EQ(r.name, folder_.filename());
  EXPECT_DOUBLE_EQ(r.weight[index(Joint::kLeftKnee)], 1.0);
  EXPECT_DOUBLE_EQ(r.weight[index(Joint::kRightKnee)], 0.5);
  EXPECT_DOUBLE_EQ(r.tolerance[index(Joint::kHead)], 25.0 * kDegree);
  EXPECT_DOUBLE_EQ(r.tolerance[index(Joint::kNeck)], kDefaultTolerance_deg * kDegree);
  EXPECT_FALSE(r.standing);
}

TEST_F(ReferenceFolder, ClipsToTheTimesAskedFor) {
  const Reference whole = load("");
  const Reference part = load("[clip]\nstart = 0.5\nend = 1.25\n");
  EXPECT_NEAR(part.motion.duration(), 0.75, 1e-9);
  EXPECT_LT(rms_distance(part.motion.poses.front(), whole.motion.poses[30]), 1e-6);
}

TEST_F(ReferenceFolder, SaysFileLineFieldAndWhatWasExpected) {
  EXPECT_THAT(complaint("name = 3\n"),
              AllOf(HasSubstr("motion.toml:1"), HasSubstr("name"), HasSubstr("text")));
  EXPECT_THAT(complaint("name = \"a\"\nnonsense = 1\n"),
              AllOf(HasSubstr("motion.toml:2"), HasSubstr("nonsense"), HasSubstr("one of")));
  EXPECT_THAT(complaint("\n[weights]\nleft_kne = 1\n"),
              AllOf(HasSubstr("motion.toml:3"), HasSubstr("left_kne"), HasSubstr("joint")));
  EXPECT_THAT(complaint("[weights]\nhead = 2.0\n"),
              AllOf(HasSubstr("motion.toml:2"), HasSubstr("weights.head"), HasSubstr("0 to 1")));
  EXPECT_THAT(complaint("[weights]\ndefault = 0\n"),
              AllOf(HasSubstr("motion.toml:1"), HasSubstr("at least one joint")));
  EXPECT_THAT(complaint("[tolerances_deg]\nhead = nan\n"),
              AllOf(HasSubstr("motion.toml:2"), HasSubstr("tolerances_deg.head")));
  EXPECT_THAT(complaint("standing = \"yes\"\n"),
              AllOf(HasSubstr("motion.toml:1"), HasSubstr("true or false")));
  EXPECT_THAT(complaint("[clip]\nstart = 1.0\nend = 0.5\n"),
              AllOf(HasSubstr("clip"), HasSubstr("start before end")));
  EXPECT_THAT(complaint("[clip]\nend = 99.0\n"),
              AllOf(HasSubstr("motion.toml:2"), HasSubstr("clip.end")));
  EXPECT_THAT(complaint("weights = 1\n"), AllOf(HasSubstr("motion.toml:1"), HasSubstr("table")));
  EXPECT_THAT(complaint("name = \"torn\n"), HasSubstr("motion.toml:1"));
}

TEST_F(ReferenceFolder, MirrorsEverythingWhenAskedTo) {
  const std::string toml =
      "[weights]\ndefault = 0.5\nleft_knee = 1\n[tolerances_deg]\nright_elbow = 25\n";
  const Reference plain = load(toml);
  const Reference other = load("mirrored = true\n" + toml);
  EXPECT_DOUBLE_EQ(other.weight[index(Joint::kRightKnee)], 1.0);
  EXPECT_DOUBLE_EQ(other.weight[index(Joint::kLeftKnee)], 0.5);
  EXPECT_DOUBLE_EQ(other.tolerance[index(Joint::kLeftElbow)], 25.0 * kDegree);
  ASSERT_EQ(other.motion.poses.size(), plain.motion.poses.size());
  for (std::size_t i = 0; i < plain.motion.poses.size(); i += 10) {
    EXPECT_LT(rms_distance(other.motion.poses[i], secondskin::mirrored(plain.motion.poses[i])),
              1e-9);
  }
  const auto& left = plain.motion.skeleton[index(Joint::kLeftHip)].p_PB;
  const auto& right = other.motion.skeleton[index(Joint::kRightHip)].p_PB;
  EXPECT_LT((right - Eigen::Vector3d(left.x(), -left.y(), left.z())).norm(), 1e-12);
}

TEST_F(ReferenceFolder, AveragesItsExpertsAndWidensTheToleranceWhereTheyDiffer) {
  const std::string toml =
      "[tolerances_deg]\ndefault = 10\n[widest_tolerances_deg]\ndefault = 24\n";
  const Motion expert = load(toml).motion;
  Motion second = expert;
  for (Pose& pose : second.poses) {
    pose.q_PB[index(Joint::kLeftKnee)] =
        pose.q_PB[index(Joint::kLeftKnee)] * quaternion_from({0.0, 0.2, 0.0});
    pose.q_PB[index(Joint::kRightElbow)] =
        pose.q_PB[index(Joint::kRightElbow)] * quaternion_from({0.0, -1.0, 0.0});
  }
  write_bvh(second, folder_ / "expert_2.bvh");
  const Reference r = load(toml);
  EXPECT_EQ(r.experts, 2U);
  ASSERT_EQ(r.band.size(), r.motion.poses.size());
  // Two 0.2 rad apart have a standard deviation of 0.2 / sqrt(2); the band is twice that.
  EXPECT_NEAR(r.tolerance_at(0.0, index(Joint::kLeftKnee)), 0.4 / std::numbers::sqrt2, 0.03);
  EXPECT_NEAR(r.tolerance_at(0.0, index(Joint::kRightElbow)), 24.0 * kDegree, 1e-9);
  EXPECT_NEAR(r.tolerance_at(0.0, index(Joint::kLeftElbow)), 10.0 * kDegree, 1e-9);
  EXPECT_EQ(r.tolerance_at(-5.0, index(Joint::kLeftKnee)),
            r.tolerance_at(0.0, index(Joint::kLeftKnee)));
  EXPECT_NEAR(r.tolerance_at(1e9, index(Joint::kLeftElbow)), 10.0 * kDegree, 1e-9);
}

TEST_F(ReferenceFolder, JoinsSeveralIntoOneReference) {
  load("name = \"mine\"\nstanding = true\n");
  const std::vector<fs::path> both{folder_, kReferences / "squat" / "motion.bvh"};
  const Reference r = load_reference(both, kJointMaps);
  EXPECT_EQ(r.name, "mine+motion");
  EXPECT_EQ(r.experts, 2U);
  EXPECT_TRUE(r.standing);
  EXPECT_FALSE(r.band.empty());
  EXPECT_THROW(load_reference(std::span<const fs::path>(), kJointMaps), std::invalid_argument);
}

TEST_F(ReferenceFolder, MissesWhatIsNotThere) {
  EXPECT_THROW(load_reference(folder_, kJointMaps), std::runtime_error);  // no motion.toml
  EXPECT_THROW(load_reference(folder_ / "nothing", kJointMaps), std::runtime_error);
}

TEST_F(ReferenceFolder, TakesAMotionFileAlone) {
  const Reference r = load_reference(folder_ / "motion.bvh", kJointMaps);
  EXPECT_EQ(r.name, "motion");
  for (const double w : r.weight) EXPECT_EQ(w, 1.0);
}

TEST(MakeReference, ResamplesAndRefusesOtherSkeletons) {
  Motion motion{canonical_skeleton(), 30.0, std::vector<Pose>(31, Pose(kJointCount))};
  EXPECT_EQ(make_reference("a", motion).motion.poses.size(), 61U);
  const Motion stick{Skeleton({Segment{.name = "stick", .parent = std::nullopt}}), 60.0,
                     std::vector<Pose>(2, Pose(1))};
  EXPECT_THROW(make_reference("b", stick), std::invalid_argument);
}

}  // namespace
}  // namespace secondskin::coach
