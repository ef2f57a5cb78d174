#include "server/optical/projector.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <random>
#include <system_error>

#include "tests/optical/calibrate/synthetic.h"

namespace secondskin::server {
namespace {

namespace fs = std::filesystem;

class ProjectorFile : public testing::Test {
 protected:
  ProjectorFile()
      : folder_(fs::path(testing::TempDir()) /
                (std::string("projector_file_") +
                 testing::UnitTest::GetInstance()->current_test_info()->name() + "_" +
                 std::to_string(std::random_device{}()))) {
    fs::create_directories(folder_);
  }
  ~ProjectorFile() override { fs::remove_all(folder_); }

  fs::path write(const std::string& text) const {
    std::ofstream(folder_ / "rig.txt") << text;
    return folder_ / "rig.txt";
  }
  std::string complaint(const std::string& text) const {
    try {
      ProjectorRig::load(write(text));
    } catch (const std::runtime_error& e) {
      return e.what();
    }
    return "(none)";
  }

  fs::path folder_;
};

TEST(Projector, HasItsValueOnTheWholePlaneOfThatValue) {
  for (const Projector& projector : test::make_rig()) {
    const Plane plane = projector.plane(77.25);
    // Three points of the plane, somewhere in front.
    const Eigen::Vector3d n = plane.a.normalized();
    const Eigen::Vector3d u = n.unitOrthogonal();
    for (const Eigen::Vector3d& p :
         {Eigen::Vector3d(plane.b / plane.a.norm() * n),
          Eigen::Vector3d(plane.b / plane.a.norm() * n + 0.2 * u),
          Eigen::Vector3d(plane.b / plane.a.norm() * n + 0.1 * n.cross(u))}) {
      EXPECT_NEAR(plane.a.dot(p), plane.b, 1e-9);
      EXPECT_NEAR(projector.value(p), 77.25, 1e-6);
    }
  }
}

TEST(Projector, HasTheGradientThatDifferencesShow) {
  const Eigen::Vector3d p(0.3, -0.2, 1.1);
  for (const Projector& projector : test::make_rig()) {
    const Eigen::RowVector3d gradient = projector.gradient(p);
    for (int k = 0; k < 3; ++k) {
      const Eigen::Vector3d step = 1e-6 * Eigen::Vector3d::Unit(k);
      const double difference = (projector.value(p + step) - projector.value(p - step)) / 2e-6;
      EXPECT_NEAR(gradient[k], difference, 1e-4);
    }
  }
}

// 2.2.3: the residual of a plane's equation is h times the error in counts.
TEST(Projector, GivesPlanesWhoseResidualIsTheDistanceTimesTheErrorInCounts) {
  const Projector projector = test::make_rig().front();
  const Eigen::Vector3d p(0.1, 0.4, 0.8);
  const double h = projector.P.row(1).head<3>().dot(p.transpose()) + projector.P(1, 3);
  const Plane plane = projector.plane(projector.value(p) - 2.0);
  EXPECT_NEAR(plane.a.dot(p) - plane.b, 2.0 * h, 1e-9);
}

TEST_F(ProjectorFile, ReadsEveryDigitThatItWrote) {
  ProjectorRig rig;
  for (const Projector& projector : test::make_rig(5)) rig.projectors.emplace_back(projector);
  rig.projectors[3].reset();
  rig.projectors.emplace_back();
  rig.save(folder_ / "rig.txt");
  const ProjectorRig read = ProjectorRig::load(folder_ / "rig.txt");
  ASSERT_EQ(read.size(), rig.size());
  for (std::size_t i = 0; i < rig.size(); ++i) {
    ASSERT_EQ(read.projectors[i].has_value(), rig.projectors[i].has_value()) << i;
    if (!rig.projectors[i]) continue;
    for (int k = 0; k < 7; ++k) {
      EXPECT_EQ(read.projectors[i]->P(k / 4, k % 4), rig.projectors[i]->P(k / 4, k % 4));
    }
    EXPECT_EQ(read.projectors[i]->P(1, 3), 1.0);
  }
}

TEST_F(ProjectorFile, LeavesNothingElseBehindWhenItIsSaved) {
  ProjectorRig rig;
  rig.projectors.resize(2);
  rig.save(folder_ / "rig.txt");
  rig.save(folder_ / "rig.txt");
  std::size_t files = 0;
  for ([[maybe_unused]] const auto& entry : fs::directory_iterator(folder_)) ++files;
  EXPECT_EQ(files, 1U);
}

TEST_F(ProjectorFile, NamesTheFileThatCannotBeSaved) {
  ProjectorRig rig;
  rig.projectors.resize(1);
  const fs::path file = folder_ / "absent" / "rig.txt";
  try {
    rig.save(file);
    FAIL() << "saved into a folder that does not exist";
  } catch (const std::system_error& e) {
    EXPECT_THAT(e.what(), testing::HasSubstr(file.string()));
    EXPECT_EQ(e.code().value(), ENOENT);
  }
}

TEST_F(ProjectorFile, TakesCommentsBlankLinesAndAnyOrder) {
  const ProjectorRig rig = ProjectorRig::load(write(
      "# a room\n\nprojectors 3  # of them two\n2 1 2 3 4 5 6 7\n\n0 -1e1 0 0 0 0 0 .5 # first\n"));
  ASSERT_EQ(rig.size(), 3U);
  EXPECT_FALSE(rig.projectors[1]);
  EXPECT_EQ(rig.projectors[0]->P(0, 0), -10.0);
  EXPECT_EQ(rig.projectors[2]->P(1, 2), 7.0);
}

TEST_F(ProjectorFile, SaysWhichFileIsMissing) {
  try {
    ProjectorRig::load(folder_ / "absent.txt");
    FAIL();
  } catch (const std::runtime_error& e) {
    EXPECT_THAT(e.what(), testing::HasSubstr("absent.txt"));
  }
}

TEST_F(ProjectorFile, NamesTheLineOfWhatItDoesNotUnderstand) {
  using testing::HasSubstr;
  EXPECT_THAT(complaint(""), HasSubstr("expected 'projectors N'"));
  EXPECT_THAT(complaint("# only a comment\n"), HasSubstr("expected 'projectors N'"));
  EXPECT_THAT(complaint("0 1 2 3 4 5 6 7\n"), HasSubstr(":1: "));
  EXPECT_THAT(complaint("projectors 0\n"), HasSubstr("1 to 255"));
  EXPECT_THAT(complaint("projectors 256\n"), HasSubstr("1 to 255"));
  EXPECT_THAT(complaint("projectors -1\n"), HasSubstr("1 to 255"));
  EXPECT_THAT(complaint("projectors many\n"), HasSubstr("1 to 255"));
  EXPECT_THAT(complaint("projectors 2\n2 1 2 3 4 5 6 7\n"), HasSubstr(":2: expected a slot"));
  EXPECT_THAT(complaint("projectors 2\nfirst 1 2 3 4 5 6 7\n"), HasSubstr("'first'"));
  EXPECT_THAT(complaint("projectors 2\n\n1 1 2 3 4 5 6\n"), HasSubstr(":3: "));
  EXPECT_THAT(complaint("projectors 2\n1 1 2 3 4 5 6 7 8\n"), HasSubstr("'8'"));
  EXPECT_THAT(complaint("projectors 2\n1 1 2 nan 4 5 6 7\n"), HasSubstr("'nan'"));
  EXPECT_THAT(complaint("projectors 2\n1 1 2 inf 4 5 6 7\n"), HasSubstr("'inf'"));
  EXPECT_THAT(complaint("projectors 2\n1 1 2 3,5 4 5 6 7\n"), HasSubstr("'3,5'"));
  EXPECT_THAT(complaint("projectors 2\n1 1 2 3 4 5 6 7\n1 1 2 3 4 5 6 7\n"),
              HasSubstr("a second time"));
}

}  // namespace
}  // namespace secondskin::server
