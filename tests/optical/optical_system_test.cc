// The optical system as a whole: bytes of virtual tags in, frames, points and poses out.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <thread>

#include "motion/bvh.h"
#include "motion/retarget.h"
#include "motion/rotation.h"
#include "server/markers/body_file.h"
#include "server/open_source.h"
#include "server/optical/byte_recorder.h"
#include "server/optical/optical_source.h"
#include "sim/optical/suit_scene.h"
#include "sim/optical/virtual_tags.h"

namespace secondskin::server {
namespace {

namespace fs = std::filesystem;

const fs::path kSource = SECONDSKIN_SOURCE_DIR;

// A body in a suit between the paper's projectors, and what is known of them.
class VirtualInstallation {
 public:
  explicit VirtualInstallation(sim::OpticalNoise noise = {})
      : suit(Suit::load(kSource / "suits" / "full_body.toml")),
        scene(sim::recentred(read_canonical(kSource / "reference_motions" / "squat" / "learner.bvh",
                                            kSource / "joint_maps")),
              suit, sim::AtEnd::kThereAndBack),
        hardware(sim::second_skin_rig(), scene, noise, 7),
        body{scene.skeleton(), {}} {
    for (const auto& projector : hardware.projectors()) {
      rig.projectors.push_back({{projector.matrix()}});
    }
    for (std::size_t d = 0; d < suit.detectors.size(); ++d) {
      body.attachments.push_back(
          {d, suit.detectors[d].name, scene.segment(d), scene.place(d).p_BS, 0.008});
    }
    folder = fs::temp_directory_path() /
             ("secondskin_optical_" + std::to_string(::getpid()) + "_" +
              ::testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::create_directories(folder);
  }
  ~VirtualInstallation() { fs::remove_all(folder); }

  std::vector<std::string> write(std::size_t cycles, const sim::TagLink& link) {
    sim::VirtualTags tags(hardware, sim::tag_sizes(suit), link, 11);
    std::vector<fs::path> files;
    for (std::size_t t = 0; t < tags.tags(); ++t) {
      files.push_back(folder / ("tag" + std::to_string(t)));
    }
    sim::write_tag_files(tags, cycles, files);
    return {files.begin(), files.end()};
  }

  std::unique_ptr<OpticalSource> open(const std::vector<std::string>& places) const {
    auto receiver = std::make_unique<OpticalReceiver>(places, format_of(suit, rig.size(), false));
    return std::make_unique<OpticalSource>(std::move(receiver), rig, suit, body);
  }

  // The largest distance of a given point from the truth, and the share of points given.
  struct Check {
    double worst = 0.0, share = 0.0;
    std::size_t frames = 0;
  };
  Check check(OpticalSource& source) {
    Check result;
    std::vector<sim::DetectorState> truth(suit.detectors.size());
    std::size_t given = 0;
    source.observe([&](const OpticalSource& s, Next what) {
      if (what != Next::kPose) return;
      scene.at(static_cast<double>(s.values().cycle + 1) * 0.016, truth);
      for (std::size_t d = 0; d < truth.size(); ++d) {
        if (s.points().visible[d] == 0) continue;
        ++given;
        result.worst = std::max(result.worst, (s.points().p_WM[d] - truth[d].p_W).norm());
      }
      ++result.frames;
    });
    for_each_pose(source, [](const StampedPose&) {});
    result.share =
        static_cast<double>(given) / static_cast<double>(result.frames * suit.detectors.size());
    return result;
  }

  Suit suit;
  sim::SuitScene scene;
  sim::VirtualRig hardware;
  ProjectorRig rig;
  MarkerBody body;
  fs::path folder;
};

// A point further off than this is wrong, not inaccurate [m].
constexpr double kWrong = 0.1;

TEST(OpticalSystem, GivesThePoseOfTheBodyThatWearsTheSuit) {
  VirtualInstallation it;
  const auto source = it.open(it.write(240, {}));
  double worst_knee = 0.0, sum = 0.0;
  std::size_t count = 0;
  Pose truth(kJointCount);
  for_each_pose(*source, [&](const StampedPose& pose) {
    if (pose.frame < 30) return;
    it.scene.pose_at(static_cast<double>(pose.frame) * 0.016, truth);
    const std::size_t knee = index(Joint::kLeftKnee);
    const double error = joint_angles(Joint::kLeftKnee, pose.pose.q_PB[knee])[0] -
                         joint_angles(Joint::kLeftKnee, truth.q_PB[knee])[0];
    worst_knee = std::max(worst_knee, std::abs(error));
    sum += (pose.pose.p_WR - truth.p_WR).norm();
    ++count;
  });
  ASSERT_GT(count, 200u);
  EXPECT_LT(worst_knee, 8.0 * std::numbers::pi / 180.0);
  EXPECT_LT(sum / static_cast<double>(count), 0.015);
}

TEST(OpticalSystem, GivesNoWrongPointThoughOneInAHundredOrOneInTenSetsIsTorn) {
  for (const double torn : {0.0, 0.01, 0.1}) {
    VirtualInstallation it;
    sim::TagLink link;
    link.torn_share = torn;
    const auto source = it.open(it.write(500, link));
    const auto check = it.check(*source);
    EXPECT_LT(check.worst, kWrong) << torn;
    EXPECT_GT(check.share, torn < 0.05 ? 0.6 : 0.4) << torn;
    std::uint64_t lost = 0;
    for (std::size_t t = 0; t < source->receiver().tags(); ++t) {
      lost += source->receiver().status(t).bytes.torn;
    }
    EXPECT_EQ(lost > 0, torn > 0.0);
  }
}

TEST(OpticalSystem, GoesOnWithAProjectorThatIsDark) {
  VirtualInstallation it;
  it.hardware.projectors()[4].dark = true;
  it.hardware.projectors()[5].dark = true;
  const auto source = it.open(it.write(300, {}));
  const auto check = it.check(*source);
  EXPECT_LT(check.worst, kWrong);
  EXPECT_GT(check.share, 0.5);
  EXPECT_EQ(source->tracker().projector_fits()[4].used, 0u);
}

TEST(OpticalSystem, SaysThatABodyWasMeasuredWithAnotherSuit) {
  VirtualInstallation it;
  it.body.attachments[3].name = "left_foot_9";
  const auto places = it.write(10, {});
  try {
    it.open(places);
    FAIL();
  } catch (const std::runtime_error& error) {
    EXPECT_NE(std::string(error.what()).find("another suit"), std::string::npos) << error.what();
    EXPECT_NE(std::string(error.what()).find("left_foot_9"), std::string::npos) << error.what();
  }
}

TEST(OpticalSystem, SaysWhatIsWrongWithItsPlaces) {
  VirtualInstallation it;
  auto places = it.write(10, {});
  places.pop_back();
  EXPECT_THROW(it.open(places), std::runtime_error);
  EXPECT_THROW(optical_places("optical:"), std::runtime_error);
  EXPECT_THROW(optical_places("optical:a,,b"), std::runtime_error);
  EXPECT_EQ(optical_places("optical:/dev/a,b"), (std::vector<std::string>{"/dev/a", "b"}));
}

TEST(OpticalSystem, CalibratesABodyFromItsOwnRecordingAndKeepsItInAFile) {
  VirtualInstallation it;
  const auto places = it.write(400, {});
  OpticalReceiver receiver(places, format_of(it.suit, it.rig.size(), false));
  const auto points = record_points(receiver, it.rig, it.suit, 1e9);
  ASSERT_EQ(points.frames.size(), 400u);
  const auto result = calibrate_body(MarkerSet::from_suit(it.suit, canonical_skeleton()), points);
  EXPECT_LT(result.residual, 0.02);
  save_body(result.body, it.folder / "body.toml");
  const auto again = load_body(it.folder / "body.toml");
  ASSERT_EQ(again.attachments.size(), result.body.attachments.size());
  EXPECT_LT((again.attachments[5].p_BM - result.body.attachments[5].p_BM).norm(), 1e-5);
  // A body of these lengths, within what anatomy lets one tell from a squat alone.
  const auto thigh = [](const Skeleton& s) { return s[index(Joint::kLeftKnee)].p_PB.norm(); };
  EXPECT_NEAR(thigh(again.skeleton), thigh(it.scene.skeleton()), 0.04);
}

TEST(OpticalSystem, NamesDetectorsThatAreExchangedInTheSuit) {
  VirtualInstallation it;
  const auto places = it.write(200, {});
  // Somebody plugged two leads the wrong way round.
  Suit wrong = it.suit;
  std::swap(wrong.detectors[2].name, wrong.detectors[40].name);
  std::swap(wrong.detectors[2].segment, wrong.detectors[40].segment);
  std::swap(wrong.detectors[2].along, wrong.detectors[40].along);
  std::swap(wrong.detectors[2].angle, wrong.detectors[40].angle);
  ASSERT_NE(it.suit.detectors[2].segment, it.suit.detectors[40].segment);
  OpticalReceiver receiver(places, format_of(wrong, it.rig.size(), false));
  const auto points = record_points(receiver, it.rig, wrong, 1e9);
  const auto result = calibrate_body(MarkerSet::from_suit(wrong, canonical_skeleton()), points);
  std::size_t named = 0;
  for (const auto& marker : result.markers) {
    const bool one = marker.name == wrong.detectors[2].name;
    const bool other = marker.name == wrong.detectors[40].name;
    if (one || other) named += marker.suspicion.empty() ? 0 : 1;
  }
  EXPECT_EQ(named, 2u);
}

TEST(ByteRecorder, WritesWhatIsReadBackAsTheSameFrames) {
  VirtualInstallation it;
  sim::TagLink link;
  link.torn_share = 0.05;
  const auto format = format_of(it.suit, it.rig.size(), false);
  OpticalReceiver receiver(it.write(200, link), format);
  std::vector<ProjectorFrame> frames;
  ProjectorFrame frame;
  std::vector<std::string> copies;
  {
    ByteRecorder recorder((it.folder / "copy").string(), format);
    while (receiver.next(frame) == Next::kPose) {
      frames.push_back(frame);
      recorder.write(frame);
    }
    EXPECT_EQ(recorder.error(), "");
    copies = recorder.files();
  }
  OpticalReceiver again(copies, format);
  std::size_t i = 0;
  for (; again.next(frame) == Next::kPose; ++i) {
    ASSERT_LT(i, frames.size());
    EXPECT_EQ(frame.cycle - frames[0].cycle, frames[i].cycle - frames[0].cycle);
    EXPECT_EQ(frame.values, frames[i].values);
  }
  EXPECT_EQ(i, frames.size());
}

// ---- in real time, over pseudo-terminals

// Reads a receiver's frames for a time.
template <class Look>
void read_for(OpticalSource& source, double seconds, Look look) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
  StampedPose pose;
  while (std::chrono::steady_clock::now() < end) {
    if (source.next(pose) == Next::kPose) look(pose);
  }
}

TEST(LiveOpticalSystem, GivesTheSamePosesFromPortsAndFromTheirRecordedBytes) {
  VirtualInstallation it;
  sim::TagLink link;
  link.latency = 0.005;
  link.jitter = 0.010;
  sim::VirtualTagsRunner tags(it.hardware, sim::tag_sizes(it.suit), link, 3);
  std::vector<std::string> ports;
  for (std::size_t t = 0; t < tags.tags(); ++t) ports.push_back(tags.path(t));
  std::vector<StampedPose> live;
  std::vector<std::string> files;
  {
    const auto source = it.open(ports);
    EXPECT_TRUE(source->live());
    ByteRecorder recorder((it.folder / "bytes").string(), source->receiver().format());
    source->observe([&](const OpticalSource& s, Next what) {
      if (what == Next::kPose) recorder.write(s.values());
    });
    const std::jthread thread([&tags](std::stop_token stop) { tags.run(stop); });
    read_for(*source, 4.0, [&](const StampedPose& pose) { live.push_back(pose); });
    files = recorder.files();
  }
  ASSERT_GT(live.size(), 120u);
  const auto recorded = it.open(files);
  EXPECT_FALSE(recorded->live());
  std::size_t i = 0;
  for_each_pose(*recorded, [&](const StampedPose& pose) {
    ASSERT_LT(i, live.size());
    EXPECT_EQ(pose.pose.p_WR, live[i].pose.p_WR) << i;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      ASSERT_EQ(pose.pose.q_PB[j].coeffs(), live[i].pose.q_PB[j].coeffs()) << i << " " << j;
    }
    ++i;
  });
  EXPECT_EQ(i, live.size());
}

TEST(LiveOpticalSystem, GoesOnWithoutATagThatIsUnpluggedAndTakesItBack) {
  VirtualInstallation it;
  std::vector<std::string> links;
  for (std::size_t t = 0; t < it.suit.tags(); ++t) {
    links.push_back((it.folder / ("port" + std::to_string(t))).string());
  }
  sim::VirtualTagsRunner tags(it.hardware, sim::tag_sizes(it.suit), {}, 3, links);
  const auto source = it.open(links);
  const std::jthread thread([&tags](std::stop_token stop) { tags.run(stop); });
  read_for(*source, 2.0, [](const StampedPose&) {});
  const std::size_t first = it.suit.detectors_of(0);  // tag 1's first detector
  const auto seen = [&](double seconds) {
    std::size_t values = 0, frames = 0;
    read_for(*source, seconds, [&](const StampedPose&) {
      const auto& v = source->values();
      const auto begin = v.values.begin() + static_cast<std::ptrdiff_t>(first * v.projectors);
      values += std::any_of(begin, begin + static_cast<std::ptrdiff_t>(18 * v.projectors),
                            [](std::uint8_t x) { return x != 0; })
                    ? 1
                    : 0;
      ++frames;
    });
    return std::pair(values, frames);
  };
  const auto before = seen(0.5);
  EXPECT_GT(before.first, before.second / 2);
  tags.unplug(1);
  seen(0.5);
  const auto away = seen(0.5);
  EXPECT_EQ(away.first, 0u);
  EXPECT_GT(away.second, 15u) << "the other tags go on";
  EXPECT_FALSE(source->receiver().status(1).connected);
  EXPECT_NE(source->receiver().status(1).trouble, "");
  tags.plug(1);
  seen(1.0);
  const auto back = seen(0.5);
  EXPECT_GT(back.first, back.second / 2);
}

}  // namespace
}  // namespace secondskin::server
