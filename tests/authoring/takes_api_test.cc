#include "clients/authoring/takes_api.h"

#include <gtest/gtest.h>

#include <chrono>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>

#include "bus/pose_messages.h"
#include "bus/reader.h"
#include "bus/writer.h"
#include "clients/authoring/references_api.h"
#include "clients/authoring/takes_json.h"
#include "server/open_source.h"
#include "tests/authoring/bench.h"

// The requests, and a recorder that hears a capture server of the test's own over DDS.
namespace secondskin::authoring {
namespace {

using nlohmann::json;
namespace msg = bus::msg;

bus::Config config() {
  return {.subject = "takes_" + std::to_string(::getpid()),
          .domain = 10U + static_cast<std::uint32_t>(::getpid()) % 90U,
          .qos_file = kRoot / "idl" / "qos.xml",
          .name = "takes_test"};
}

/// Who is measured: both arms, up and down every 1.2 s, 60 poses a second.
class Capture {
 public:
  explicit Capture(bus::Participant& participant) : skeletons_(participant), poses_(participant) {
    describe(1.75);
  }

  void describe(double stature) {
    const Skeleton skeleton = canonical_skeleton(stature);
    id_ = bus::skeleton_id(skeleton);
    msg::SkeletonDefinition message;
    bus::to_message(skeleton, "test:arms", 60.0, message);
    skeletons_.write(message);
  }

  /// @param drop  every so many frames one is not sent; 0: none
  void play(double seconds, int drop = 0) {
    const auto n = static_cast<int>(seconds * 60.0);
    for (int i = 0; i < n; ++i) {
      std::this_thread::sleep_until(next_);
      next_ = std::max(next_, std::chrono::steady_clock::now() - std::chrono::milliseconds(50)) +
              std::chrono::nanoseconds(16'666'667);
      ++frame_;
      if (drop > 0 && i % drop == drop - 1) continue;
      const double phase = static_cast<double>(frame_) / 72.0;
      const Motion one = arms({0.5 - 0.5 * std::cos(2.0 * std::numbers::pi * phase)}, 60.0);
      msg::SkeletonPose message;
      bus::to_message({frame_, bus::now_ns(), one.poses.front()}, id_, message);
      poses_.write(message);
    }
  }

 private:
  bus::Writer<msg::SkeletonDefinition> skeletons_;
  bus::Writer<msg::SkeletonPose> poses_;
  std::chrono::steady_clock::time_point next_ = std::chrono::steady_clock::now();
  std::uint64_t frame_ = 0;
  std::uint32_t id_ = 0;
};

class TakesOverHttp : public OwnFolder {
 protected:
  static void SetUpTestSuite() { participant_ = new bus::Participant(config()); }
  static void TearDownTestSuite() { delete participant_; }

  TakesOverHttp()
      : store_(std::make_shared<TakeStore>(folder_ / "takes", kJointMaps)),
        recorder_(std::make_shared<TakeRecorder>(*participant_,
                                                 [this](const Recorded& take) {
                                                   store_->add(take.motion, take.source,
                                                               take.start_ns, take.faults);
                                                 })),
        handler_(takes_api({.takes = store_,
                            .recorder = recorder_,
                            .import =
                                [](const std::filesystem::path& file) {
                                  server::SourceSettings settings;
                                  settings.joint_maps = kJointMaps;
                                  settings.marker_sets = kRoot / "marker_sets";
                                  return server::read_all(
                                      *server::open_source(file.string(), settings));
                                },
                            .joint_maps = kJointMaps,
                            .own = folder_ / "references",
                            .references = [this] { return folders(); }})),
        references_(references_api({.joint_maps = kJointMaps,
                                    .idl = kRoot / "idl" / "secondskin_msgs.idl",
                                    .own = folder_ / "references",
                                    .references = [this] { return folders(); }})),
        thread_([this](std::stop_token stop) { recorder_->run(stop); }) {}

  std::vector<std::filesystem::path> folders() const {
    std::vector<std::filesystem::path> all{kRoot / "reference_motions" / "wave_hello"};
    if (!std::filesystem::exists(folder_ / "references")) return all;
    for (const auto& entry : std::filesystem::directory_iterator(folder_ / "references")) {
      all.push_back(entry.path());
    }
    return all;
  }

  dashboard::HttpResponse ask(const std::string& method, const std::string& path,
                              const std::string& body = {},
                              std::map<std::string, std::string> query = {}) const {
    const dashboard::HttpRequest request{method, path, std::move(query), body};
    auto response = handler_(request);
    if (!response) response = references_(request);
    EXPECT_TRUE(response.has_value()) << path;
    return response.value_or(dashboard::HttpResponse{.status = 0, .body = {}, .file_name = {}});
  }

  json get(const std::string& path) const { return json::parse(ask("GET", path).body); }

  std::string error(const dashboard::HttpResponse& response, unsigned status) const {
    EXPECT_EQ(response.status, status) << response.body;
    return json::parse(response.body, nullptr, false).value("error", "");
  }

  void play_until_alive(Capture& capture) const {
    for (int i = 0; i < 100 && get("/api/takes")["state"]["alive"] != true; ++i) capture.play(0.1);
    ASSERT_EQ(get("/api/takes")["state"]["alive"], true);
  }

  // Until so much of the recording under way is over.
  void play_for(Capture& capture, double seconds) const {
    for (int i = 0; i < 100 && get("/api/takes")["state"]["elapsed"] < seconds; ++i) {
      capture.play(0.1);
    }
  }

  std::string bring(const std::string& file = "reference_motions/deep_squat/learner.bvh") const {
    std::ifstream in(kRoot / file, std::ios::binary);
    const std::string bytes{std::istreambuf_iterator<char>(in), {}};
    const auto response = ask("POST", "/api/takes/import", bytes, {{"name", "squats.bvh"}});
    EXPECT_EQ(response.status, 201U) << response.body;
    return json::parse(response.body).at("id");
  }

  json parts_of(const std::string& id) const {
    json parts = json::array();
    const json all = get("/api/takes");
    for (const json& take : all["takes"]) {
      if (take["id"] != id) continue;
      for (const json& part : take["parts"]) {
        parts.push_back({{"take", id}, {"start", part["start"]}, {"end", part["end"]}});
      }
    }
    return parts;
  }

  static inline bus::Participant* participant_ = nullptr;
  std::shared_ptr<TakeStore> store_;
  std::shared_ptr<TakeRecorder> recorder_;
  dashboard::HttpHandler handler_, references_;
  std::jthread thread_;
};

TEST_F(TakesOverHttp, RecordsWhoIsMeasuredAndNamesLostFrames) {
  bus::Participant other(config());
  Capture capture(other);
  play_until_alive(capture);
  EXPECT_EQ(ask("POST", "/api/takes/record", R"({"countdown": 0.5, "most_seconds": 60})").status,
            202U);
  EXPECT_EQ(get("/api/takes")["state"]["phase"], "countdown");
  EXPECT_NE(error(ask("POST", "/api/takes/record", "{}"), 409).find("under way"),
            std::string::npos);
  capture.play(0.8);
  EXPECT_EQ(get("/api/takes")["state"]["phase"], "recording");
  capture.play(1.3, 20);
  const json after = json::parse(ask("POST", "/api/takes/stop", "{}").body);
  EXPECT_EQ(after["state"]["phase"], "idle");
  ASSERT_EQ(after["takes"].size(), 1U) << after["state"];
  const json& take = after["takes"][0];
  EXPECT_EQ(take["source"], "test:arms");
  EXPECT_NEAR(take["duration"].get<double>(), 1.6, 0.3);
  ASSERT_EQ(take["faults"].size(), 1U) << take["faults"];
  EXPECT_EQ(take["faults"][0].get<std::string>().substr(0, 2), "3 ");
  EXPECT_NE(take["faults"][0].get<std::string>().find("frames were lost"), std::string::npos);
  const auto recorded = take["recorded"].get<std::string>();
  EXPECT_EQ(recorded.size(), 24U) << recorded;
  EXPECT_EQ(recorded.back(), 'Z');
}

TEST_F(TakesOverHttp, EndsWithTheSourceAndWithTheBody) {
  bus::Participant other(config());
  Capture capture(other);
  play_until_alive(capture);
  ASSERT_EQ(ask("POST", "/api/takes/record", R"({"countdown": 0})").status, 202U);
  play_for(capture, 0.7);
  capture.describe(1.60);
  for (int i = 0; i < 50 && get("/api/takes")["state"]["phase"] != "idle"; ++i) capture.play(0.1);
  ASSERT_EQ(ask("POST", "/api/takes/record", R"({"countdown": 0})").status, 202U);
  play_for(capture, 0.7);
  for (int i = 0; i < 40 && get("/api/takes")["state"]["phase"] != "idle"; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  const json all = get("/api/takes")["takes"];
  ASSERT_EQ(all.size(), 2U);
  EXPECT_NE(all[0]["faults"].dump().find("body changed"), std::string::npos) << all[0];
  EXPECT_NE(all[1]["faults"].dump().find("went silent"), std::string::npos) << all[1];
}

TEST_F(TakesOverHttp, PausesASessionThatRuns) {
  bus::Participant other(config());
  Capture capture(other);
  bus::Writer<msg::SessionState> states(other);
  bus::Reader<msg::SessionCommand> orders(other);
  msg::SessionState state;
  state.phase(msg::SESSION_RUNNING);
  states.write(state);
  play_until_alive(capture);
  ask("POST", "/api/takes/record", R"({"countdown": 0.3})");
  capture.play(0.6);
  msg::SessionCommand order;
  ASSERT_GT(orders.take_newest(order), 0U);
  EXPECT_EQ(order.action(), msg::SESSION_PAUSE);
  EXPECT_TRUE(get("/api/takes")["state"]["paused"]);
}

TEST_F(TakesOverHttp, RefusesToRecordNobody) {
  EXPECT_NE(error(ask("POST", "/api/takes/record", "{}"), 409).find("nobody is measured"),
            std::string::npos);
  for (const char* body :
       {R"({"countdown": -1})", R"({"countdown": "5"})", R"({"countdown": 61})"}) {
    EXPECT_NE(error(ask("POST", "/api/takes/record", body), 400).find("countdown"),
              std::string::npos)
        << body;
  }
  EXPECT_NE(
      error(ask("POST", "/api/takes/record", R"({"most_seconds": 1e9})"), 400).find("most_seconds"),
      std::string::npos);
  EXPECT_NE(error(ask("POST", "/api/takes/record", R"({"other": 1})"), 400).find("other"),
            std::string::npos);
}

TEST_F(TakesOverHttp, FromAFileToAReference) {
  const std::string id = bring();
  const json parts = parts_of(id);
  ASSERT_EQ(parts.size(), 3U);
  const json motion = get("/api/takes/" + id + "/motion");
  EXPECT_LE(motion["rate_hz"].get<double>(), kDrawnRate);
  EXPECT_EQ(motion["skeleton"].size(), kJointCount);
  EXPECT_EQ(motion["poses"][0].size(), 3U + 4U * kJointCount);

  const auto drafted = ask("POST", "/api/takes/draft", json{{"parts", parts}}.dump());
  ASSERT_EQ(drafted.status, 200U) << drafted.body;
  const json draft = json::parse(drafted.body);
  EXPECT_EQ(draft["experts"], 3U);
  EXPECT_EQ(draft["when"].size(), 3U);
  EXPECT_EQ(draft["when"][0].size(), draft["mean"]["poses"].size());
  EXPECT_EQ(draft["joints"].size(), kJointCount);

  const json wish{{"name", "my_squat"},
                  {"description", "mine"},
                  {"parts", parts},
                  {"standing", true},
                  {"joints", {{"left_knee", {{"weight", 0.9}, {"tolerance_deg", 11.5}}}}}};
  const auto saved = ask("POST", "/api/takes/save", wish.dump());
  ASSERT_EQ(saved.status, 201U) << saved.body;
  const auto reference = coach::load_reference(folder_ / "references" / "my_squat", kJointMaps);
  EXPECT_EQ(reference.experts, 3U);
  EXPECT_NEAR(reference.weight[index(Joint::kLeftKnee)], 0.9, 1e-9);
  EXPECT_NEAR(reference.tolerance[index(Joint::kLeftKnee)] * 180.0 / std::numbers::pi, 11.5, 1e-9);
  // What was not named is as it was proposed.
  for (const json& joint : draft["joints"]) {
    const auto j = index(*find_joint(joint["name"].get<std::string>()));
    if (j == index(Joint::kLeftKnee)) continue;
    EXPECT_NEAR(reference.weight[j], joint["weight"].get<double>(), 1e-9) << joint["name"];
    EXPECT_NEAR(reference.tolerance[j] * 180.0 / std::numbers::pi,
                joint["tolerance_deg"].get<double>(), 1e-9)
        << joint["name"];
  }
  // And what was drawn is what the coach loads, to the four decimals that are sent.
  const json shown = json::parse(
      ask("POST", "/api/takes/draft", json{{"parts", parts}, {"joints", wish["joints"]}}.dump())
          .body);
  const json loaded = to_json(reference.motion);
  ASSERT_EQ(shown["mean"]["poses"].size(), loaded["poses"].size());
  for (std::size_t i = 0; i < loaded["poses"].size(); ++i) {
    for (std::size_t k = 0; k < loaded["poses"][i].size(); ++k) {
      ASSERT_NEAR(shown["mean"]["poses"][i][k].get<double>(), loaded["poses"][i][k].get<double>(),
                  1.1e-4)
          << i << " " << k;
    }
  }
  EXPECT_NE(error(ask("POST", "/api/takes/save", wish.dump()), 409).find("exists already"),
            std::string::npos);
  bool listed = false;
  for (const json& entry : get("/api/references")) {
    listed = listed || (entry["name"] == "my_squat" && entry["own"] == true);
  }
  EXPECT_TRUE(listed);
}

TEST_F(TakesOverHttp, ExportedReferencesComeBack) {
  for (const char* format : {"bvh", "mcap", "c3d", "trc", "csv"}) {
    const auto response = ask("GET", "/api/references/wave_hello/export", {}, {{"format", format}});
    ASSERT_EQ(response.status, 200U) << response.body;
    EXPECT_EQ(response.file_name, std::string("wave_hello.") + format);
    if (std::string(format) != "bvh" && std::string(format) != "mcap") continue;
    const auto again =
        ask("POST", "/api/takes/import", response.body, {{"name", response.file_name}});
    ASSERT_EQ(again.status, 201U) << again.body;
    EXPECT_NEAR(json::parse(again.body)["duration"].get<double>(),
                coach::load_reference(kRoot / "reference_motions" / "wave_hello", kJointMaps)
                    .motion.duration(),
                0.05);
  }
  EXPECT_NE(error(ask("GET", "/api/references/wave_hello/export", {}, {{"format", "exe"}}), 400)
                .find("format"),
            std::string::npos);
  for (const char* name : {"../wave_hello", "no_such", "..", "/etc"}) {
    error(ask("GET", std::string("/api/references/") + name + "/export", {}, {{"format", "bvh"}}),
          404);
  }
}

TEST_F(TakesOverHttp, RefusesFilesThatAreNoMotion) {
  const auto bring = [&](const char* name, const std::string& bytes) {
    return error(ask("POST", "/api/takes/import", bytes, {{"name", name}}), 400);
  };
  EXPECT_NE(bring("a.exe", "x").find("a.exe"), std::string::npos);
  EXPECT_NE(bring("../../x.bvh", "HIERARCHY\nnonsense").find("x.bvh:2"), std::string::npos);
  EXPECT_NE(bring("x.c3d", std::string(600, '\0')).find("x.c3d"), std::string::npos);
  EXPECT_NE(bring("x.mcap", "no").find("x.mcap"), std::string::npos);
  EXPECT_NE(bring("x.bvh", "").find("body"), std::string::npos);
  error(ask("POST", "/api/takes/import", "x"), 400);
  EXPECT_TRUE(get("/api/takes")["takes"].empty());
}

TEST_F(TakesOverHttp, RefusesBadRequestsAndNamesTheField) {
  const std::string id = bring();
  const auto draft = [&](const json& body) {
    return error(ask("POST", "/api/takes/draft", body.dump()), 400);
  };
  EXPECT_NE(draft({{"parts", "all"}}).find("parts"), std::string::npos);
  EXPECT_NE(draft({{"parts", json::array()}}).find("at least one"), std::string::npos);
  EXPECT_NE(draft({{"parts", {{{"take", id}, {"start", 0}, {"end", 99}}}}}).find("parts[0]"),
            std::string::npos);
  EXPECT_NE(draft({{"parts", {{{"take", id}, {"start", "0"}, {"end", 1}}}}}).find("parts[0].start"),
            std::string::npos);
  EXPECT_NE(error(ask("POST", "/api/takes/draft", "{"), 400).find("JSON"), std::string::npos);
  error(ask("POST", "/api/takes/draft", R"({"parts": [{"take": "../x", "start": 0, "end": 1}]})"),
        404);
  const auto save = [&](const json& extra) {
    json body{{"name", "x"}, {"parts", parts_of(id)}};
    body.update(extra);
    return error(ask("POST", "/api/takes/save", body.dump()), 400);
  };
  EXPECT_NE(save({{"name", "../x"}}).find("name"), std::string::npos);
  EXPECT_NE(save({{"standing", 1}}).find("standing"), std::string::npos);
  EXPECT_NE(save({{"joints", {{"tail", json::object()}}}}).find("joints.tail"), std::string::npos);
  EXPECT_NE(save({{"joints", {{"head", {{"weight", 2}}}}}}).find("joints.head.weight"),
            std::string::npos);
  EXPECT_NE(
      save({{"joints", {{"head", {{"tolerance_deg", 0}}}}}}).find("joints.head.tolerance_deg"),
      std::string::npos);
  EXPECT_FALSE(std::filesystem::exists(folder_ / "references" / "x"));
  error(ask("PUT", "/api/takes/" + id, R"({"parts": [{"start": 2, "end": 1}]})"), 400);
  error(ask("DELETE", "/api/takes/none"), 404);
  error(ask("GET", "/api/takes/none/motion"), 404);
  error(ask("POST", "/api/takes"), 405);
  EXPECT_EQ(ask("DELETE", "/api/takes/" + id).status, 204U);
  EXPECT_FALSE(handler_({"GET", "/api/takesX", {}, {}}).has_value());
  EXPECT_FALSE(references_({"GET", "/api/references/wave_hello", {}, {}}).has_value());
}

}  // namespace
}  // namespace secondskin::authoring
