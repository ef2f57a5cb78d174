#include "clients/authoring/take.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <limits>
#include <stdexcept>

#include "tests/authoring/bench.h"

namespace secondskin::authoring {
namespace {

using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

class Takes : public OwnFolder {
 protected:
  TakeStore store() const { return TakeStore(folder_ / "takes", kJointMaps); }
  static Motion two() {
    std::vector<double> way;
    rest(way, 0.5, 60.0);
    raise(way, 1.5, 60.0);
    rest(way, 0.5, 60.0);
    raise(way, 1.5, 60.0);
    rest(way, 0.5, 60.0);
    return arms(way, 60.0);
  }
};

TEST_F(Takes, AreKeptAcrossAStore) {
  Motion motion = two();
  for (Pose& pose : motion.poses) pose.confidence[index(Joint::kLeftToes)] = 0.0F;
  const TakeInfo added = store().add(motion, "replay:a.bvh", 1'764'000'000'123'000'000, {"lost 3"});
  EXPECT_EQ(added.id, "20251124-160000-123");
  EXPECT_EQ(added.parts.size(), 2U);

  TakeStore again = store();
  const auto all = again.list();
  ASSERT_EQ(all.size(), 1U);
  EXPECT_EQ(all[0].id, added.id);
  EXPECT_EQ(all[0].source, "replay:a.bvh");
  EXPECT_THAT(all[0].faults, ::testing::ElementsAre("lost 3"));
  EXPECT_EQ(all[0].parts.size(), 2U);
  const Take take = again.load(added.id);
  ASSERT_EQ(take.motion.poses.size(), motion.poses.size());
  EXPECT_EQ(take.motion.poses[0].confidence[index(Joint::kLeftToes)], 0.0F);
  EXPECT_EQ(take.motion.poses[0].confidence[index(Joint::kRightToes)], 1.0F);
  for (std::size_t i = 0; i < motion.poses.size(); i += 20) {
    EXPECT_LT(geodesic_distance(take.motion.poses[i].q_PB[index(Joint::kLeftShoulder)],
                                motion.poses[i].q_PB[index(Joint::kLeftShoulder)]),
              1e-4)
        << i;
  }
}

TEST_F(Takes, OfTheSameInstantHaveNamesOfTheirOwn) {
  TakeStore takes = store();
  const auto a = takes.add(two(), "x", 5), b = takes.add(two(), "x", 5);
  EXPECT_NE(a.id, b.id);
  EXPECT_EQ(takes.list().size(), 2U);
}

TEST_F(Takes, CanBeDeleted) {
  TakeStore takes = store();
  const auto info = takes.add(two(), "x", 5);
  takes.remove(info.id);
  EXPECT_TRUE(takes.list().empty());
  EXPECT_THROW(takes.remove(info.id), std::out_of_range);
  EXPECT_EQ(files_in(folder_ / "takes"), 0U);
}

TEST_F(Takes, NeverLeaveTheirFolder) {
  std::filesystem::create_directories(folder_ / "other");
  std::ofstream(folder_ / "other" / "take.json") << "{}";
  TakeStore takes = store();
  takes.add(two(), "x", 5);
  for (const char* id : {"../other", "..", ".", "", "/etc", "a/../../other"}) {
    EXPECT_THROW(takes.load(id), std::out_of_range) << id;
    EXPECT_THROW(takes.remove(id), std::out_of_range) << id;
  }
  EXPECT_TRUE(std::filesystem::exists(folder_ / "other" / "take.json"));
}

TEST_F(Takes, RememberCutsMovedByHand) {
  const auto id = store().add(two(), "x", 5).id;
  store().set_parts(id, {{{0.5, 1.9}, true}, {{2.0, 4.0}, false}});
  TakeStore takes = store();
  const auto all = takes.list();
  ASSERT_EQ(all.at(0).parts.size(), 2U);
  EXPECT_DOUBLE_EQ(all[0].parts[0].span.end, 1.9);
  EXPECT_FALSE(all[0].parts[1].chosen);
  EXPECT_EQ(all[0].cutting.repetitions.size(), 2U);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const Span bad : {Span{-0.1, 1.0}, Span{1.0, 0.5}, Span{0.0, 99.0}, Span{1.0, 1.1},
                         Span{nan, 1.0}, Span{0.0, nan}}) {
    EXPECT_THAT(([&] {
                  takes.set_parts(id, {{{0.5, 1.9}, true}, {bad, true}});
                }),
                ThrowsMessage<std::invalid_argument>(HasSubstr("parts[1]")));
  }
}

TEST_F(Takes, OneWithBrokenFilesIsLeftOut) {
  TakeStore takes = store();
  takes.add(two(), "x", 5);
  const auto broken = takes.add(two(), "x", 6).id;
  std::ofstream(folder_ / "takes" / broken / "take.json") << "{\"recorded_ns\": ";
  EXPECT_EQ(store().list().size(), 1U);
}

TEST_F(Takes, RefuseAPoseThatIsNotFinite) {
  Motion motion = two();
  motion.poses[7].p_WR.x() = std::numeric_limits<double>::quiet_NaN();
  TakeStore takes = store();
  EXPECT_THROW(takes.add(motion, "x", 5), std::invalid_argument);
  EXPECT_EQ(files_in(folder_ / "takes"), 0U);
}

}  // namespace
}  // namespace secondskin::authoring
