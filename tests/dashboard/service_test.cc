#include "clients/dashboard/dashboard_service.h"

#include <gmock/gmock.h>

#include <thread>

#include "bus/pose_messages.h"
#include "bus/reader.h"
#include "bus/topics.h"
#include "bus/writer.h"
#include "tests/bus/test_domain.h"
#include "tests/dashboard/web_client.h"

// The bridge over real DDS, between a test that plays the other services and one that plays a page.
namespace secondskin::dashboard {
namespace {

namespace msg = bus::msg;
using bus::eventually;
using bus::test_config;
using test::WebClient;
using testing::HasSubstr;
using namespace std::chrono_literals;

class DashboardServiceTest : public testing::Test {
 protected:
  DashboardServiceTest() : config_(test_config()), here_(config_), there_(config_) {
    const std::filesystem::path root = SECONDSKIN_SOURCE_DIR;
    DashboardOptions options;
    options.web.port = 0;
    options.idl = root / "idl" / "secondskin_msgs.idl";
    options.foxglove_schemas = root / "idl" / "foxglove";
    options.reference = [this](const std::string& name) {
      return name == reference_->name ? reference_ : nullptr;
    };
    Motion motion{canonical_skeleton(), 60.0, {}};
    for (int i = 0; i < 60; ++i) {
      Pose pose(kJointCount);
      pose.p_WR.z() = 1.0;
      pose.q_PB[index(Joint::kLeftElbow)] = joint_rotation(Joint::kLeftElbow, {0.02 * i, 0.0, 0.0});
      motion.poses.push_back(pose);
    }
    reference_ = std::make_shared<coach::Reference>(coach::make_reference("curl", motion));
    service_ = std::make_unique<DashboardService>(there_, options);
    runner_ = std::jthread([this](std::stop_token stop) { service_->run(stop); });
  }
  ~DashboardServiceTest() override {
    runner_.request_stop();
    runner_.join();
    service_.reset();
  }

  std::string topic(const std::string& name) const {
    return "/secondskin/" + config_.subject + "/" + name;
  }
  template <class Message>
  static Message decoded(const WebClient::Message& from) {
    const std::string payload = from.payload();
    Message message;
    EXPECT_TRUE(bus::decode({reinterpret_cast<const std::uint8_t*>(payload.data()), payload.size()},
                            message));
    return message;
  }
  template <class Message>
  void connect(bus::Writer<Message>& writer) {
    ASSERT_TRUE(eventually([&] { return writer.counts().readers >= 1; }));
  }

  bus::Config config_;
  bus::Participant here_, there_;
  std::shared_ptr<const coach::Reference> reference_;
  std::unique_ptr<DashboardService> service_;
  std::jthread runner_;
};

TEST_F(DashboardServiceTest, OffersEveryTopicWithItsSchema) {
  WebClient page(service_->port());
  const auto channels = page.read_op("advertise")["channels"];
  ASSERT_EQ(channels.size(), bus::kTopics.size() + 3);
  for (std::size_t t = 0; t < bus::kTopics.size(); ++t) {
    EXPECT_EQ(channels[t]["topic"], topic(std::string(bus::kTopics[t].name)));
    EXPECT_EQ(channels[t]["encoding"], "cdr");
    EXPECT_EQ(channels[t]["schemaEncoding"], "omgidl");
    EXPECT_THAT(channels[t]["schema"].get<std::string>(), HasSubstr("struct SkeletonPose"));
  }
  EXPECT_EQ(channels[1]["schemaName"], "secondskin_msgs::msg::SkeletonPose");
  EXPECT_EQ(channels[bus::kTopics.size()]["topic"], topic("expert"));
  EXPECT_EQ(channels[bus::kTopics.size() + 1]["schemaName"], "foxglove.FrameTransforms");
  EXPECT_EQ(channels[bus::kTopics.size() + 2]["topic"], "/scene");
}

TEST_F(DashboardServiceTest, ForwardsAPoseAsItWasPublished) {
  bus::Writer<msg::SkeletonPose> poses(here_);
  connect(poses);
  WebClient page(service_->port());
  page.subscribe(1, page.read_channels().at(topic("pose")));
  StampedPose pose;
  pose.pose = Pose(kJointCount);
  pose.pose.p_WR = {1.0, 2.0, 3.0};
  msg::SkeletonPose sent;
  std::jthread publisher([&](std::stop_token stop) {
    for (pose.frame = 1; !stop.stop_requested(); ++pose.frame) {
      pose.stamp_ns = bus::now_ns();
      bus::to_message(pose, 77, sent);
      poses.write(sent);
      std::this_thread::sleep_for(10ms);
    }
  });
  std::uint64_t frame = 0;
  for (int i = 0; i < 20; ++i) {
    const auto message = page.read_of(1);
    const auto got = decoded<msg::SkeletonPose>(message);
    EXPECT_EQ(got.root_position().y(), 2.0);
    EXPECT_EQ(got.skeleton_id(), 77u);
    EXPECT_GT(got.header().frame(), frame);
    frame = got.header().frame();
    // Its writer's clock, at most a moment after the measurement.
    EXPECT_GE(message.time_ns(), got.header().stamp_ns());
    EXPECT_LT(message.time_ns() - got.header().stamp_ns(), 1'000'000'000);
  }
}

TEST_F(DashboardServiceTest, ALatePageGetsTheSessionsRepetitionsAndEachServicesHealth) {
  bus::Writer<msg::SessionState> states(here_);
  bus::Writer<msg::RepetitionScore> repetitions(here_);
  bus::Writer<msg::ServiceHealth> health(here_);
  connect(states);
  connect(repetitions);
  connect(health);
  const auto repetition = [&](std::uint32_t number, std::int64_t start) {
    msg::RepetitionScore score;
    score.repetition(number);
    score.start_ns(start);
    repetitions.write(score);
  };
  WebClient first(service_->port());
  const auto channels = first.read_channels();
  first.subscribe(1, channels.at(topic("repetition")));
  first.subscribe(2, channels.at(topic("session_state")));
  first.subscribe(3, channels.at(topic("health")));
  msg::SessionState state;
  state.session_start_ns(1000);
  states.write(state);
  first.read_of(2);
  repetition(1, 1100);
  EXPECT_EQ(decoded<msg::RepetitionScore>(first.read_of(1)).repetition(), 1u);
  state.session_start_ns(2000);  // another session
  states.write(state);
  EXPECT_EQ(decoded<msg::SessionState>(first.read_of(2)).session_start_ns(), 2000);
  repetition(1, 2100);
  repetition(2, 2200);
  first.read_of(1);
  first.read_of(1);
  std::size_t heard = 0;
  for (const char* service : {"capture", "coach", "coach"}) {
    msg::ServiceHealth words;
    words.service(service);
    words.samples(++heard);
    health.write(words);
  }
  const auto of_ours = [&](WebClient& page) {
    for (;;) {
      const auto words = decoded<msg::ServiceHealth>(page.read_of(3));
      if (words.service().to_string() != "dashboard") return words;
    }
  };
  for (int i = 0; i < 3; ++i) of_ours(first);

  WebClient late(service_->port());
  late.read_channels();
  late.subscribe(1, channels.at(topic("repetition")));
  EXPECT_EQ(decoded<msg::RepetitionScore>(late.read_of(1)).start_ns(), 2100);
  EXPECT_EQ(decoded<msg::RepetitionScore>(late.read_of(1)).start_ns(), 2200);
  late.subscribe(3, channels.at(topic("health")));
  EXPECT_EQ(of_ours(late).samples(), 1u);  // the capture's
  EXPECT_EQ(of_ours(late).samples(), 3u);  // the coach's newest
}

TEST_F(DashboardServiceTest, PassesSessionCommandsOnWithItsOwnTime) {
  bus::Reader<msg::SessionCommand> commands(here_, bus::Want::kEvery);
  ASSERT_TRUE(eventually([&] { return commands.counts().writers == 1; }));
  WebClient page(service_->port());
  page.read_channels();
  const std::int64_t before = bus::now_ns();
  page.publish(1, topic("session"), "json", R"({"action": "start", "learner": "p1"})");
  msg::SessionCommand heard;
  ASSERT_TRUE(eventually([&] { return commands.take(heard); }));
  EXPECT_EQ(heard.action(), msg::SESSION_START);
  EXPECT_EQ(heard.learner().to_string(), "p1");
  EXPECT_GE(heard.publish_ns(), before);
  heard.action(msg::SESSION_PAUSE);
  heard.publish_ns(5);
  const auto cdr = bus::encode(heard);
  page.publish(2, topic("session"), "cdr", {cdr.begin(), cdr.end()});
  ASSERT_TRUE(eventually([&] { return commands.take(heard); }));
  EXPECT_EQ(heard.action(), msg::SESSION_PAUSE);
  EXPECT_GE(heard.publish_ns(), before);
  page.publish(1, topic("session"), "json", "{}");
  EXPECT_THAT(page.read_op("status")["message"].get<std::string>(), HasSubstr("'action'"));
  page.publish(3, topic("tactors"), "cdr", "x");
  EXPECT_THAT(page.read_op("status")["message"].get<std::string>(), HasSubstr("expected"));
}

TEST_F(DashboardServiceTest, AnyPageStopsAllVibration) {
  bus::Reader<msg::EmergencyStop> stops(here_, bus::Want::kEvery);
  ASSERT_TRUE(eventually([&] { return stops.counts().writers == 1; }));
  WebClient page(service_->port()), other(service_->port());
  page.read_channels();
  other.subscribe(1, other.read_channels().at(topic("stop")));
  page.publish(1, topic("stop"), "json", R"({"active": true, "reason": "button"})");
  msg::EmergencyStop heard;
  ASSERT_TRUE(eventually([&] { return stops.take(heard); }));
  EXPECT_TRUE(heard.active());
  EXPECT_EQ(heard.reason().to_string(), "button");
  EXPECT_TRUE(decoded<msg::EmergencyStop>(other.read_of(1)).active());  // every page shows it
}

TEST_F(DashboardServiceTest, ShowsTheExpertWhereTheLearnerStands) {
  bus::Writer<msg::SkeletonDefinition> skeletons(here_);
  bus::Writer<msg::SkeletonPose> poses(here_);
  bus::Writer<msg::SessionState> states(here_);
  bus::Writer<msg::Alignment> alignments(here_);
  connect(skeletons);
  connect(poses);
  connect(states);
  connect(alignments);
  const Skeleton body = canonical_skeleton(1.6);
  msg::SkeletonDefinition definition;
  bus::to_message(body, "test", 60.0, definition);
  skeletons.write(definition);
  msg::SessionState state;
  state.session_start_ns(1);
  state.reference("curl");
  state.block_tempo(0.5);
  states.write(state);

  WebClient page(service_->port());
  const auto channels = page.read_channels();
  page.subscribe(1, channels.at(topic("expert")));
  page.subscribe(2, channels.at("/tf"));
  page.subscribe(3, channels.at("/scene"));
  std::jthread publisher([&](std::stop_token stop) {
    StampedPose pose;
    pose.pose = Pose(kJointCount);
    pose.pose.p_WR = {4.0, 5.0, 0.9};
    msg::SkeletonPose sent;
    msg::Alignment where;
    where.reference_time(1.0);  // at half the tempo: the middle
    for (pose.frame = 1; !stop.stop_requested(); ++pose.frame) {
      pose.stamp_ns = bus::now_ns();
      bus::to_message(pose, bus::skeleton_id(body), sent);
      poses.write(sent);
      where.header().frame(pose.frame);
      where.header().stamp_ns(pose.stamp_ns);
      alignments.write(where);
      std::this_thread::sleep_for(10ms);
    }
  });
  const auto expert = decoded<msg::SkeletonPose>(page.read_of(1));
  EXPECT_EQ(expert.skeleton_id(), bus::skeleton_id(body));
  EXPECT_EQ(expert.root_position().x(), 4.0);
  EXPECT_EQ(expert.root_position().y(), 5.0);
  StampedPose got;
  ASSERT_TRUE(bus::from_message(expert, got));
  EXPECT_NEAR(joint_angles(Joint::kLeftElbow, got.pose.q_PB[index(Joint::kLeftElbow)])[0],
              0.02 * 60.0 * 0.5, 0.02);
  const auto tf = nlohmann::json::parse(page.read_of(2).payload());
  EXPECT_EQ(tf["transforms"][0]["child_frame_id"], config_.subject + "/pelvis");
  nlohmann::json scene;
  for (int i = 0; i < 100 && scene["entities"].size() < 3; ++i) {
    scene = nlohmann::json::parse(page.read_of(3).payload());
  }
  EXPECT_EQ(scene["entities"].size(), 3u);
}

}  // namespace
}  // namespace secondskin::dashboard
