#include <fmt/format.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdio>
#include <map>
#include <nlohmann/json.hpp>
#include <regex>
#include <thread>

#include "bus/pose_messages.h"
#include "bus/reader.h"
#include "clients/stream/vmc_performer.h"
#include "motion/rotation.h"
#include "recording/mcap_reader.h"
#include "tests/session/session.h"
#include "wire/mvn.h"
#include "wire/udp.h"

// The senders and the MVN source as processes of a session, over real UDP on this machine.

namespace secondskin::session {
namespace {

using nlohmann::json;
namespace msg = bus::msg;

const std::string kLearner = SECONDSKIN_SOURCE_DIR "/reference_motions/low_block/learner.bvh";

// What one subject's capture server publishes.
class Poses {
 public:
  Poses(std::uint32_t domain, const std::string& subject)
      : participant_([&] {
          bus::Config config;
          config.domain = domain;
          config.subject = subject;
          config.qos_file = SECONDSKIN_SOURCE_DIR "/idl/qos.xml";
          return config;
        }()),
        bodies_(participant_, bus::Want::kEvery),
        poses_(participant_, bus::Want::kEvery) {}

  void take() {
    while (bodies_.take(body_)) {
      skeleton.emplace(bus::to_skeleton(body_));
      ++bodies;
    }
    while (poses_.take(message_)) {
      StampedPose pose;
      ASSERT_TRUE(bus::from_message(message_, pose));
      by_frame[pose.frame] = pose;
    }
  }

  std::map<std::uint64_t, StampedPose> by_frame;
  std::optional<Skeleton> skeleton;  // the newest
  std::size_t bodies = 0;

 private:
  bus::Participant participant_;
  bus::Reader<msg::SkeletonDefinition> bodies_;
  bus::Reader<msg::SkeletonPose> poses_;
  msg::SkeletonDefinition body_;
  msg::SkeletonPose message_;
};

class Streams : public testing::Test {
 protected:
  std::vector<std::string> on(const std::string& subject, std::vector<std::string> command) const {
    command.insert(command.end(), {"--domain", std::to_string(domain_), "--subject", subject});
    return command;
  }
  Process start(const std::string& name, const std::vector<std::string>& command) const {
    return Process(command, folder_ / (name + ".log"));
  }

  Folder folder_;
  std::uint32_t domain_ = 10 + static_cast<std::uint32_t>(::getpid()) % 90;
  std::string sent_ = "sent_" + std::to_string(::getpid());
  std::string read_ = "read_" + std::to_string(::getpid());
};

double angle_between(const Pose& a, const Pose& b) {
  double worst = 0.0;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    worst = std::max(worst, geodesic_distance(a.q_PB[j], b.q_PB[j]));
  }
  return worst;
}

// Which frame of `sent` a pose is: the frames are numbered anew by the reader, from the first
// sample that it saw.
std::uint64_t offset_of(const StampedPose& read, const std::map<std::uint64_t, StampedPose>& sent) {
  std::uint64_t best = 0;
  double least = 1e9;
  for (const auto& [frame, pose] : sent) {
    const double distance = angle_between(read.pose, pose.pose);
    if (distance < least) {
      least = distance;
      best = frame - read.frame;
    }
  }
  return best;
}

// Of 30 samples one goes astray on the way, one comes late, and one comes after a half of itself.
class LossyWay {
 public:
  explicit LossyWay(std::uint16_t to) : sender_({"127.0.0.1", to}), receiver_({"127.0.0.1", 0}) {
    thread_ = std::jthread([this](std::stop_token stop) { run(stop); });
  }
  std::string port() const { return std::to_string(receiver_.place().port); }
  void end() { thread_ = {}; }

  std::uint64_t dropped = 0, swapped = 0, bent = 0;
  std::uint64_t skipped = 0;  // by the sender, which sends the newest pose only

 private:
  void run(std::stop_token stop) {
    std::vector<std::uint8_t> buffer(65536), held;
    std::uint64_t poses = 0, just_dropped = 0;
    std::uint32_t last = 0;
    while (!stop.stop_requested()) {
      const auto arrival = receiver_.receive(buffer, 20ms);
      if (!arrival) continue;
      const std::vector<std::uint8_t> datagram(
          buffer.begin(), buffer.begin() + static_cast<std::ptrdiff_t>(arrival->length));
      wire::MvnFault fault{};
      const auto header = wire::decode_mvn_header(datagram, fault);
      if (!header || header->type_text() != wire::kMvnPose) {
        sender_.send(datagram);
        continue;
      }
      if (poses > 0) skipped += header->sample - last - 1;
      last = header->sample;
      // The first second is left alone, so that all losses are between poses.
      if (++poses < 60) {
        sender_.send(datagram);
        continue;
      }
      if (poses % 30 == 7) {
        just_dropped = 1;
        continue;
      }
      if (poses % 30 == 15) {
        held = datagram;
        continue;
      }
      if (poses % 30 == 20) {
        auto cut = datagram;
        cut.resize(cut.size() / 2);
        sender_.send(cut);
        ++bent;
      }
      sender_.send(datagram);
      dropped += std::exchange(just_dropped, 0);  // it shows only by a later one
      if (!held.empty()) {
        sender_.send(held);
        held.clear();
        ++swapped;
      }
    }
  }

  wire::UdpSender sender_;
  wire::UdpReceiver receiver_;
  std::jthread thread_;
};

std::uint16_t free_port() { return wire::UdpReceiver({"127.0.0.1", 0}).place().port; }

TEST_F(Streams, ACaptureOfMvnGivesThePosesThatWereSent) {
  const std::uint16_t port = free_port();
  LossyWay way(port);
  Poses sent(domain_, sent_), read(domain_, read_);
  Process reader = start("reader", on(read_, {"capture", "mvn:" + std::to_string(port)}));
  Process sender = start("sender", on(sent_, {"mvn", "--to", way.port()}));
  Process capture = start("capture", on(sent_, {"capture", kLearner, "--loop", "--wait-for", "2"}));
  ASSERT_TRUE(eventually(
      [&] {
        sent.take();
        read.take();
        return read.by_frame.size() >= 200;
      },
      30s))
      << reader.output() << sender.output() << capture.output();
  capture.end(SIGTERM);
  ASSERT_TRUE(capture.wait(10s));
  sender.end(SIGTERM);
  ASSERT_TRUE(sender.wait(10s));
  way.end();
  std::this_thread::sleep_for(100ms);
  sent.take();
  read.take();
  reader.end(SIGTERM);
  ASSERT_TRUE(reader.wait(10s));
  EXPECT_EQ(reader.exit_code(), 0) << reader.output();

  ASSERT_TRUE(sent.skeleton && read.skeleton);
  EXPECT_EQ(read.bodies, 1u);  // the avatar's, and no average one before it was known
  for (std::size_t j = 1; j < kJointCount; ++j) {
    EXPECT_LT(((*read.skeleton)[j].p_PB - (*sent.skeleton)[j].p_PB).norm(), 1e-5)
        << (*sent.skeleton)[j].name;
  }
  const std::uint64_t offset = offset_of(read.by_frame.begin()->second, sent.by_frame);
  std::size_t compared = 0;
  double worst_angle = 0.0, worst_place = 0.0, worst_time = 0.0;
  for (const auto& [frame, pose] : read.by_frame) {
    const auto from = sent.by_frame.find(frame + offset);
    if (from == sent.by_frame.end()) continue;  // published before this test was found
    ++compared;
    worst_angle = std::max(worst_angle, angle_between(pose.pose, from->second.pose));
    worst_place = std::max(worst_place, (pose.pose.p_WR - from->second.pose.p_WR).norm());
    worst_time = std::max(
        worst_time, 1e-9 * std::abs(static_cast<double>(pose.stamp_ns - from->second.stamp_ns)));
  }
  EXPECT_GE(compared, 110u);
  EXPECT_LT(worst_angle, 1e-5);  // [rad]
  EXPECT_LT(worst_place, 1e-5);  // [m]
  RecordProperty("worst_angle_rad", fmt::format("{:.2g}", worst_angle));
  RecordProperty("worst_place_m", fmt::format("{:.2g}", worst_place));
  RecordProperty("worst_time_ms", fmt::format("{:.2g}", 1e3 * worst_time));

  // What the way did to them shows in what the reader counted.
  EXPECT_GT(way.dropped, 3u);
  std::smatch said;
  const std::string words = reader.output();
  ASSERT_TRUE(std::regex_search(
      words, said,
      std::regex(
          "mvn: ([0-9]+) samples lost, ([0-9]+) late, ([0-9]+) incomplete, ([0-9]+) datagrams")))
      << words;
  EXPECT_EQ(std::stoull(said[1]), way.dropped + way.swapped + way.skipped) << words;
  EXPECT_EQ(std::stoull(said[2]), way.swapped) << words;
  EXPECT_EQ(std::stoull(said[3]), 0u) << words;
  EXPECT_EQ(std::stoull(said[4]), way.bent) << words;
}

TEST_F(Streams, ASessionTrainsWhoWearsAnMvnSuit) {
  const std::uint16_t port = free_port();
  Process sender = start("sender", on(sent_, {"mvn", "--to", std::to_string(port)}));
  Process capture = start("capture", on(sent_, {"capture", kLearner, "--loop"}));
  const std::string recording = folder_ / "session.mcap";
  Process train = start("train", on(read_, {"train", "--reference", "low_block", "--learner",
                                            "mvn:" + std::to_string(port), "--dashboard-port", "0",
                                            "--history", "none", "--recording", recording}));
  ASSERT_TRUE(eventually([&] { return train.says("session 1"); }, 30s)) << train.output();
  std::this_thread::sleep_for(2s);
  train.end(SIGINT);
  ASSERT_TRUE(train.wait(20s));
  EXPECT_EQ(train.exit_code(), 0) << train.output();
  std::smatch said;
  const std::string words = train.output();
  ASSERT_TRUE(
      std::regex_search(words, said, std::regex("Session: ([0-9]+) poses, ([0-9]+) coached")))
      << words;
  EXPECT_GT(std::stoi(said[2]), 30) << words;
  EXPECT_FALSE(train.says("session 2")) << words;  // the body was known from the start
  // What was recorded can be aligned: its poses are of its body.
  Process align = start("align", {"align", "--reference", "low_block", recording, "--json"});
  ASSERT_TRUE(align.wait(20s));
  EXPECT_EQ(align.exit_code(), 0) << align.output().substr(0, 500);
  EXPECT_FALSE(align.says("another body"));
}

TEST_F(Streams, MvnSaysWhatIsMissing) {
  const std::uint16_t port = free_port();
  bus::Config config;
  config.domain = domain_;
  config.subject = read_;
  config.qos_file = SECONDSKIN_SOURCE_DIR "/idl/qos.xml";
  bus::Participant participant(config);
  bus::Reader<msg::ServiceHealth> health(participant, bus::Want::kEvery);
  Process reader = start("reader", on(read_, {"capture", "mvn:" + std::to_string(port)}));
  wire::UdpSender sender({"127.0.0.1", port});
  auto euler = wire::encode_mvn_pose({}, std::vector<wire::MvnSegment>(23, {1, {}, {1, 0, 0, 0}}));
  euler[5] = '1';
  msg::ServiceHealth message;
  EXPECT_TRUE(eventually(
      [&] {
        sender.send(euler);
        while (health.take(message)) {
          if (message.message().to_string().find("type 01") != std::string::npos) return true;
        }
        return false;
      },
      20s))
      << reader.output();
  EXPECT_EQ(message.state(), msg::SERVICE_WAITING);
}

TEST_F(Streams, AnIndependentOscDecoderReadsTheBonesThatWereSent) {
  constexpr int kFrames = 60;
  FILE* pipe = ::popen(
      ("node '" SECONDSKIN_VMC_CHECK "' " + std::to_string(kFrames) + " 2>&1").c_str(), "r");
  ASSERT_NE(pipe, nullptr);
  int port = 0;
  ASSERT_EQ(std::fscanf(pipe, "port %d", &port), 1);
  Process recorder = start("record", on(sent_, {"record", folder_ / "live.mcap"}));
  Process sender = start("sender", on(sent_, {"vmc", "--to", std::to_string(port)}));
  Process capture = start("capture", on(sent_, {"capture", kLearner, "--loop", "--wait-for", "2"}));
  std::string said;
  char buffer[65536];
  for (std::size_t got; (got = std::fread(buffer, 1, sizeof buffer, pipe)) > 0;) {
    said.append(buffer, got);
  }
  EXPECT_EQ(::pclose(pipe), 0) << said.substr(0, 2000);
  recorder.end(SIGTERM);
  ASSERT_TRUE(recorder.wait(10s));
  ASSERT_EQ(recorder.exit_code(), 0) << recorder.output() << sender.output() << capture.output();

  std::optional<Skeleton> body;
  std::vector<StampedPose> published;
  recording::McapReader recording(folder_ / "live.mcap");
  const auto bodies = recording.find("/skeleton"), poses = recording.find("/pose");
  ASSERT_TRUE(bodies && poses);
  recording.for_each([&](const recording::McapMessage& message) {
    msg::SkeletonDefinition skeleton;
    msg::SkeletonPose pose;
    StampedPose stamped;
    if (message.channel == bodies->id && bus::decode(message.data, skeleton)) {
      body.emplace(bus::to_skeleton(skeleton));
    } else if (message.channel == poses->id && bus::decode(message.data, pose) &&
               bus::from_message(pose, stamped)) {
      published.push_back(stamped);
    }
    return true;
  });
  ASSERT_TRUE(body);

  const json datagrams = json::parse(said, nullptr, false);
  ASSERT_TRUE(datagrams.is_array()) << said.substr(0, 2000);
  ASSERT_GE(datagrams.size(), 2u * kFrames - 1);
  // One frame: what comes from an OK up to the next.
  std::size_t frames = 0, compared = 0, at = 0;
  double time = -1.0, worst = 0.0;
  std::map<std::string, json> bones;
  const auto finish = [&] {
    if (bones.empty()) return;
    ++frames;
    ASSERT_EQ(bones.size(), kJointCount);
    // The recorder may have missed the first ones; each later frame is that of a pose of its own.
    for (std::size_t i = at; i < published.size(); ++i) {
      const auto expected = stream::unity_bones(*body, published[i].pose);
      double error = 0.0;
      for (std::size_t j = 0; j < kJointCount; ++j) {
        const json& values = bones.at(std::string(stream::kUnityBones[j]));
        for (std::size_t k = 0; k < 3; ++k) {
          error = std::max(error, std::abs(values[1 + k].get<double>() - expected[j].position[k]));
        }
        for (std::size_t k = 0; k < 4; ++k) {
          error = std::max(error, std::abs(values[4 + k].get<double>() - expected[j].rotation[k]));
        }
      }
      if (error > 1e-6) continue;
      worst = std::max(worst, error);
      at = i + 1;
      ++compared;
      break;
    }
    bones.clear();
  };
  for (const json& datagram : datagrams) {
    EXPECT_LE(datagram["size"].get<int>(), 1472);
    for (const json& message : datagram["messages"]) {
      const std::string address = message["address"];
      const json& values = message["values"];
      if (address == "/VMC/Ext/OK") {
        finish();
        EXPECT_EQ(values, json::array({1, 3, 0}));
      } else if (address == "/VMC/Ext/T") {
        EXPECT_EQ(message["types"], "float");
        EXPECT_GT(values[0].get<double>(), time);
        time = values[0];
      } else if (address == "/VMC/Ext/Root/Pos") {
        EXPECT_EQ(values, json::array({"root", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0}));
      } else {
        ASSERT_EQ(address, "/VMC/Ext/Bone/Pos");
        EXPECT_EQ(message["types"], "string float float float float float float float");
        bones[values[0]] = values;
      }
    }
  }
  finish();
  EXPECT_GE(frames, std::size_t{kFrames});
  EXPECT_GE(compared, frames - 10);  // the recorder may be found later than the sender
  RecordProperty("compared", static_cast<int>(compared));
  RecordProperty("worst", fmt::format("{:.2g}", worst));
  EXPECT_NEAR(time, kFrames / 60.0, 1.0);

  // The decoder is gone by now; the sender goes on without it.
  capture.end(SIGTERM);
  ASSERT_TRUE(capture.wait(10s));
  sender.end(SIGTERM);
  ASSERT_TRUE(sender.wait(10s));
  EXPECT_EQ(sender.exit_code(), 0) << sender.output();
}

TEST_F(Streams, BadPlacesAreRefusedByName) {
  for (const auto& command :
       std::vector<std::vector<std::string>>{{"vmc", "--to", "somewhere"},
                                             {"mvn", "--to", "127.0.0.1:0"},
                                             {"capture", "mvn:"},
                                             {"capture", "mvn:127.0.0.1:70000"},
                                             {"capture", "mvn:localhost:9763"}}) {
    Process refused = start("refused", command);
    ASSERT_TRUE(refused.wait(10s));
    EXPECT_NE(refused.exit_code(), 0);
    EXPECT_TRUE(refused.says("ADDRESS:PORT") || refused.says("no IPv4 address"))
        << refused.output();
  }
}

TEST_F(Streams, AnMvnStreamIsExportedUntilSomebodyEndsIt) {
  const std::uint16_t port = free_port();
  const std::string file = folder_ / "suit.csv";
  Process writer = start("export", {"export", "mvn:" + std::to_string(port), "--to", file});
  Process sender = start("sender", on(sent_, {"mvn", "--to", std::to_string(port)}));
  Process capture = start("capture", on(sent_, {"capture", kLearner, "--loop"}));
  ASSERT_TRUE(eventually(
      [&] {
        return std::filesystem::exists(file + ".part") &&
               std::filesystem::file_size(file + ".part") > 20'000;
      },
      20s))
      << writer.output();
  writer.end(SIGINT);
  ASSERT_TRUE(writer.wait(10s));
  EXPECT_EQ(writer.exit_code(), 0) << writer.output();
  const std::string table = read_text(file);
  EXPECT_EQ(table.rfind("t,root_x", 0), 0u) << table.substr(0, 80);
  EXPECT_GT(std::count(table.begin(), table.end(), '\n'), 30);
}

}  // namespace
}  // namespace secondskin::session
