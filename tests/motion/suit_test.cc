#include "motion/suit.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <fstream>
#include <map>
#include <set>

namespace secondskin {
namespace {

using testing::AllOf;
using testing::HasSubstr;

const std::filesystem::path kSuits = SECONDSKIN_SOURCE_DIR "/suits";

std::map<Joint, std::vector<SuitDetector>> by_segment(const Suit& suit) {
  std::map<Joint, std::vector<SuitDetector>> result;
  for (const SuitDetector& detector : suit.detectors) result[detector.segment].push_back(detector);
  return result;
}

std::size_t named(const Suit& suit, std::string_view part) {
  return static_cast<std::size_t>(
      std::count_if(suit.detectors.begin(), suit.detectors.end(),
                    [&](const SuitDetector& d) { return d.name.find(part) == 0; }));
}

TEST(Suit, OfThePaperHasTheDetectorsOf2_1_4) {
  const Suit suit = Suit::load(kSuits / "second_skin.toml");
  EXPECT_EQ(suit.name, "second_skin");
  EXPECT_EQ(suit.detectors.size(), 26U);
  EXPECT_EQ(named(suit, "left_wrist"), 6U);
  EXPECT_EQ(named(suit, "left_forearm"), 4U);
  EXPECT_EQ(named(suit, "left_upper_arm"), 6U);
  EXPECT_EQ(named(suit, "back"), 6U);
  EXPECT_EQ(named(suit, "chest") + named(suit, "stomach"), 4U);
  EXPECT_EQ(suit.tags(), 2U);
  EXPECT_EQ(suit.detectors_of(0) + suit.detectors_of(1), 26U);
}

TEST(Suit, OfTheWholeBodyCoversEverySegmentOnAllSides) {
  const Suit suit = Suit::load(kSuits / "full_body.toml");
  EXPECT_EQ(suit.detectors.size(), 90U);
  EXPECT_EQ(suit.tags(), 5U);
  const auto segments = by_segment(suit);
  const Skeleton body = canonical_skeleton();
  for (const Joint needed :
       {Joint::kPelvis, Joint::kSpineUpper, Joint::kHead, Joint::kLeftShoulder, Joint::kLeftElbow,
        Joint::kLeftWrist, Joint::kLeftHip, Joint::kLeftKnee, Joint::kLeftAnkle}) {
    for (const Joint segment : {needed, mirrored(needed)}) {
      ASSERT_TRUE(segments.contains(segment)) << joint_name(segment);
      const auto& detectors = segments.at(segment);
      EXPECT_GE(detectors.size(), 4U) << joint_name(segment);
      // Well spread: no line comes near to all of them.
      Eigen::Vector3d mean = Eigen::Vector3d::Zero();
      std::vector<Eigen::Vector3d> places;
      for (const SuitDetector& d : detectors) {
        places.push_back(skin_place(body, d.segment, d.along, d.angle).p_BS);
        mean += places.back() / static_cast<double>(detectors.size());
      }
      Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
      for (const Eigen::Vector3d& p : places) spread += (p - mean) * (p - mean).transpose();
      const Eigen::Vector3d squares =
          Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(spread).eigenvalues();
      EXPECT_GT(std::sqrt(squares[1] / static_cast<double>(places.size())), 0.015)
          << joint_name(segment);
    }
  }
}

TEST(Suit, OfTheWholeBodyIsTheSameOnBothSides) {
  const Suit suit = Suit::load(kSuits / "full_body.toml");
  const Skeleton body = canonical_skeleton();
  const Eigen::Vector3d mirror(1.0, -1.0, 1.0);
  for (const SuitDetector& a : suit.detectors) {
    if (a.segment == Joint::kHead) continue;
    const Eigen::Vector3d p = skin_place(body, a.segment, a.along, a.angle).p_BS;
    EXPECT_TRUE(std::any_of(suit.detectors.begin(), suit.detectors.end(), [&](const auto& b) {
      return b.segment == mirrored(a.segment) &&
             (mirror.cwiseProduct(skin_place(body, b.segment, b.along, b.angle).p_BS) - p).norm() <
                 1e-9;
    })) << a.name;
  }
}

TEST(Suit, ShippedOnesHaveNoTwoDetectorsInOnePlace) {
  const Skeleton body = canonical_skeleton();
  for (const char* file : {"second_skin.toml", "full_body.toml"}) {
    for (const auto& [segment, detectors] : by_segment(Suit::load(kSuits / file))) {
      for (std::size_t i = 0; i < detectors.size(); ++i) {
        for (std::size_t k = 0; k < i; ++k) {
          const auto place = [&](const SuitDetector& d) {
            return skin_place(body, segment, d.along, d.angle).p_BS;
          };
          EXPECT_GT((place(detectors[i]) - place(detectors[k])).norm(), 0.02)
              << detectors[i].name << " " << detectors[k].name;
        }
      }
    }
  }
}

class SuitFile : public testing::Test {
 protected:
  std::filesystem::path file_ =
      std::filesystem::path(testing::TempDir()) /
      (std::string("suit_") + testing::UnitTest::GetInstance()->current_test_info()->name() +
       ".toml");
  ~SuitFile() override { std::filesystem::remove(file_); }

  static std::string detector(const std::string& name, int tag, int input,
                              const std::string& rest =
                                  "segment = \"head\"\nalong = 0.5\n"
                                  "angle_deg = 90\n") {
    return "[[detector]]\nname = \"" + name + "\"\ntag = " + std::to_string(tag) +
           "\ninput = " + std::to_string(input) + "\n" + rest;
  }
  Suit load(const std::string& text) {
    std::ofstream(file_) << text;
    return Suit::load(file_);
  }
  std::string error(const std::string& text) {
    try {
      load(text);
    } catch (const std::runtime_error& e) {
      return e.what();
    }
    return "no error";
  }
  const std::string head_ = "name = \"test\"\n";  // line 1
};

TEST_F(SuitFile, MayNameItsDetectorsInAnyOrder) {
  const Suit suit = load(head_ + detector("c", 1, 0) + detector("b", 0, 1) + detector("a", 0, 0));
  ASSERT_EQ(suit.detectors.size(), 3U);
  EXPECT_EQ(suit.detectors[0].name, "a");
  EXPECT_EQ(suit.detectors[1].name, "b");
  EXPECT_EQ(suit.detectors[2].name, "c");
  EXPECT_EQ(suit.detectors[2].segment, Joint::kHead);
  EXPECT_DOUBLE_EQ(suit.detectors[2].angle, std::numbers::pi / 2);
  EXPECT_EQ(suit.tags(), 2U);
  EXPECT_EQ(suit.detectors_of(0), 2U);
}

TEST_F(SuitFile, IsRefusedWithFileLineAndField) {
  const std::string rest = "segment = \"head\"\nalong = 0.5\nangle_deg = 0\n";
  EXPECT_THAT(error(head_ + detector("a", 0, 0) + detector("a", 0, 1)),
              AllOf(HasSubstr(file_.string() + ":10:"), HasSubstr("\"a\" is doubled")));
  EXPECT_THAT(error(head_ + detector("a", 0, 0) + detector("b", 0, 0)),
              AllOf(HasSubstr(":12:"), HasSubstr("input: 0 of tag 0 is doubled")));
  EXPECT_THAT(error(head_ + detector("a", 0, 18)), AllOf(HasSubstr(":5:"), HasSubstr("0 to 17")));
  EXPECT_THAT(error(head_ + detector("a", -1, 0)), HasSubstr(":4: tag: expected a whole number"));
  EXPECT_THAT(error(head_ + detector("a", 0, 0, "segment = \"heart\"\nalong=0.5\nangle_deg=0\n")),
              AllOf(HasSubstr(":6:"), HasSubstr("\"heart\" is no canonical joint")));
  EXPECT_THAT(error(head_ + detector("a", 0, 0, "segment = \"head\"\nalong=1.5\nangle_deg=0\n")),
              HasSubstr(":7: along: expected a number from 0 to 1"));
  EXPECT_THAT(error(head_ + detector("a", 0, 0, "segment = \"head\"\nalong=nan\nangle_deg=0\n")),
              HasSubstr("along"));
  EXPECT_THAT(error(head_ + detector("a", 0, 0, "segment = \"head\"\nalong=0.5\n")),
              HasSubstr("no angle_deg"));
  EXPECT_THAT(error(head_ + detector("a", 0, 0, rest + "angel = 1\n")),
              AllOf(HasSubstr(":9:"), HasSubstr("\"angel\"")));
  EXPECT_THAT(error(detector("a", 0, 0)), HasSubstr("no name"));
  EXPECT_THAT(error(head_), HasSubstr("no [[detector]]"));
  EXPECT_THAT(error("name = "), HasSubstr(file_.string() + ":1:"));
}

TEST_F(SuitFile, IsRefusedWithAGapInItsPlugs) {
  EXPECT_THAT(error(head_ + detector("a", 0, 0) + detector("b", 0, 2)),
              HasSubstr("tag 0 input 1 has no detector"));
  EXPECT_THAT(error(head_ + detector("a", 0, 1)), HasSubstr("tag 0 input 0 has no detector"));
  EXPECT_THAT(error(head_ + detector("a", 1, 0)), HasSubstr("tag 0 input 0 has no detector"));
  EXPECT_THAT(error(head_ + detector("a", 0, 0) + detector("b", 2, 0)),
              HasSubstr("tag 1 input 0 has no detector"));
  EXPECT_THAT(error(head_ + detector("a", 0, 0) + detector("b", 1, 1)),
              HasSubstr("tag 1 input 0 has no detector"));
}

TEST(Suit, ThatIsNotThereIsNamed) {
  EXPECT_THROW(
      {
        try {
          Suit::load("/nowhere/suit.toml");
        } catch (const std::runtime_error& e) {
          EXPECT_THAT(e.what(), HasSubstr("/nowhere/suit.toml"));
          throw;
        }
      },
      std::runtime_error);
}

}  // namespace
}  // namespace secondskin
