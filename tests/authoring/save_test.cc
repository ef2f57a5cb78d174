#include "clients/authoring/save.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <csignal>
#include <fstream>
#include <limits>
#include <stdexcept>
#include <system_error>

#include "coach/reference.h"
#include "tests/authoring/bench.h"

namespace secondskin::authoring {
namespace {

using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

Motion once() {
  std::vector<double> way;
  raise(way, 2.0, 60.0);
  return arms(way, 60.0);
}

class Save : public OwnFolder {
 protected:
  std::filesystem::path save(const Recipe& recipe) const {
    return save_reference(recipe, folder_, kJointMaps);
  }
};

TEST_F(Save, WritesWhatTheRecipeSays) {
  Recipe recipe = plain_recipe("arm-raise_2", {once(), once(), once()});
  recipe.description = "Both arms, \"slowly\" \\ up\nand ünder";
  recipe.origin = "a test";
  recipe.standing = true;
  recipe.weight[index(Joint::kLeftKnee)] = 0.25;
  recipe.tolerance[index(Joint::kHead)] = 0.5;
  const auto folder = save(recipe);
  EXPECT_EQ(folder, folder_ / "arm-raise_2");
  EXPECT_EQ(files_in(folder_), 1U);
  EXPECT_EQ(files_in(folder), 4U);
  const auto reference = coach::load_reference(folder, kJointMaps);
  EXPECT_EQ(reference.name, recipe.name);
  EXPECT_EQ(reference.description, recipe.description);
  EXPECT_EQ(reference.origin, recipe.origin);
  EXPECT_EQ(reference.licence, "private");
  EXPECT_TRUE(reference.standing);
  EXPECT_EQ(reference.experts, 3U);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    EXPECT_NEAR(reference.weight[j], recipe.weight[j], 1e-9);
    EXPECT_NEAR(reference.tolerance[j], recipe.tolerance[j], 1e-9);
  }
}

TEST_F(Save, KeepsTheOrderOfManyPerformances) {
  const auto folder = save(plain_recipe("many", std::vector<Motion>(11, once())));
  EXPECT_TRUE(std::filesystem::exists(folder / "expert_002.bvh"));
  EXPECT_TRUE(std::filesystem::exists(folder / "expert_011.bvh"));
  EXPECT_EQ(coach::load_reference(folder, kJointMaps).experts, 11U);
}

TEST_F(Save, RefusesNamesThatWouldLeaveTheFolder) {
  for (const char* name : {"", ".", "..", ".hidden", "a/b", "../x", "/x"}) {
    EXPECT_THAT([&] { save(plain_recipe(name, {once()})); },
                ThrowsMessage<std::invalid_argument>(HasSubstr("name")))
        << name;
  }
  EXPECT_THROW(save(plain_recipe(std::string(65, 'a'), {once()})), std::invalid_argument);
  EXPECT_EQ(files_in(folder_), 0U);
}

TEST(ReferenceName, IsOneThatASessionCommandMayName) {
  for (const char* name : {"squat", "my_squat-2", "9"}) {
    EXPECT_NO_THROW(require_reference_name(name)) << name;
  }
  for (const char* name : {"", ".", "a/b", "two words", "-x", "_x", "ü", "a.b"}) {
    EXPECT_THROW(require_reference_name(name), std::invalid_argument) << name;
  }
  EXPECT_THROW(require_reference_name(std::string(65, 'a')), std::invalid_argument);
}

TEST_F(Save, NeverWritesOverAReference) {
  save(plain_recipe("squat", {once()}));
  std::ofstream(folder_ / "squat" / "mine.txt") << "kept";
  EXPECT_THAT([&] { save(plain_recipe("squat", {once()})); },
              ThrowsMessage<std::invalid_argument>(HasSubstr("exists already")));
  EXPECT_TRUE(std::filesystem::exists(folder_ / "squat" / "mine.txt"));
  EXPECT_EQ(files_in(folder_), 1U);
}

TEST_F(Save, RefusesNumbersThatAreNone) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const double bad : {nan, -0.1, 1.1}) {
    Recipe recipe = plain_recipe("x", {once()});
    recipe.weight[index(Joint::kLeftKnee)] = bad;
    EXPECT_THAT([&] { save(recipe); },
                ThrowsMessage<std::invalid_argument>(HasSubstr("joints.left_knee.weight")));
  }
  for (const double bad : {nan, 0.0, 4.0}) {
    Recipe recipe = plain_recipe("x", {once()});
    recipe.tolerance[index(Joint::kHead)] = bad;
    EXPECT_THAT([&] { save(recipe); },
                ThrowsMessage<std::invalid_argument>(HasSubstr("joints.head.tolerance_deg")));
  }
  Recipe none = plain_recipe("x", {once()});
  none.weight.fill(0.0);
  EXPECT_THAT([&] { save(none); },
              ThrowsMessage<std::invalid_argument>(HasSubstr("at least one weight")));
  EXPECT_THROW(save(plain_recipe("x", {})), std::invalid_argument);
  Recipe text = plain_recipe("x", {once()});
  text.description = "\xff";
  EXPECT_THAT([&] { save(text); },
              ThrowsMessage<std::invalid_argument>(HasSubstr("description: expected UTF-8")));
  EXPECT_EQ(files_in(folder_), 0U);
}

TEST_F(Save, WritesNothingWhereItMayNotWrite) {
  std::ofstream(folder_ / "file") << "no folder";
  EXPECT_THROW(save_reference(plain_recipe("x", {once()}), folder_ / "file", kJointMaps),
               std::system_error);
}

// A file may grow to 4 kB only: as on a full disk, writing fails in the middle.
TEST_F(Save, LeavesNothingBehindOnAFullDisk) {
  const auto before = std::signal(SIGXFSZ, SIG_IGN);
  rlimit old{}, small{};
  ASSERT_EQ(::getrlimit(RLIMIT_FSIZE, &old), 0);
  small = {4096, old.rlim_max};
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &small), 0);
  EXPECT_THROW(save(plain_recipe("x", {once()})), std::system_error);
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &old), 0);
  std::signal(SIGXFSZ, before);
  EXPECT_EQ(files_in(folder_), 0U);
}

}  // namespace
}  // namespace secondskin::authoring
