// How often Fast DDS itself calls malloc to carry one pose, once all is warm: on the thread that
// writes, on the thread that takes, and on its own threads. Both ways that a message can go: handed
// over inside the process, and through UDP on the loopback as between processes. The conversions to
// and from our types are not in it: they allocate nothing (tests/coach_allocation).
// docs/benchmarks.md quotes the output.

#include <fmt/core.h>
#include <spdlog/spdlog.h>
#include <sys/wait.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <nlohmann/json.hpp>

#include "bench/live_session.h"
#include "bus/pose_messages.h"
#include "bus/reader.h"
#include "bus/wait_set.h"
#include "bus/writer.h"
#include "motion/anatomy.h"

namespace {
thread_local long of_this_thread = 0;
std::atomic<long> of_all_threads{0};

void count() noexcept {
  ++of_this_thread;
  of_all_threads.fetch_add(1, std::memory_order_relaxed);
}
}  // namespace

extern "C" {
void* __libc_malloc(std::size_t);
void* __libc_calloc(std::size_t, std::size_t);
void* __libc_realloc(void*, std::size_t);

void* malloc(std::size_t size) {
  count();
  return __libc_malloc(size);
}
void* calloc(std::size_t number, std::size_t size) {
  count();
  return __libc_calloc(number, size);
}
void* realloc(void* at, std::size_t size) {
  count();
  return __libc_realloc(at, size);
}
}

namespace {

using namespace secondskin;
using namespace std::chrono_literals;
namespace msg = bus::msg;

struct Options {
  std::uint32_t domain = 10 + static_cast<std::uint32_t>(::getpid()) % 90;
  int frames = 1000;
};

nlohmann::json run(const Options& options) {
  const bus::Config config{.subject = fmt::format("bench_{}", ::getpid()),
                           .domain = options.domain,
                           .reach = bus::Reach::kThisMachine,
                           .qos_file = bench::kRoot / "idl" / "qos.xml",
                           .name = "secondskin_dds_allocation_bench"};
  bus::Participant writing(config), reading(config);
  bus::Writer<msg::SkeletonPose> writer(writing);
  bus::Reader<msg::SkeletonPose> reader(reading);
  bus::WaitSet news;
  news.attach(reader);
  if (!writer.wait_for_readers(1, 10s)) throw std::runtime_error("the reader was not found");
  StampedPose pose;
  pose.pose = Pose(kJointCount);
  msg::SkeletonPose sent, taken;
  bus::to_message(pose, 1, sent);
  long in_write = 0, in_wait = 0, in_take = 0, missed = 0, all_before = 0;
  constexpr int kWarmUp = 200;
  const auto start = std::chrono::steady_clock::now();
  for (int i = 0; i < kWarmUp + options.frames; ++i) {
    if (i == kWarmUp) {
      in_write = in_wait = in_take = missed = 0;
      all_before = of_all_threads;
    }
    std::this_thread::sleep_until(start + i * 16ms);
    const long before = of_this_thread;
    writer.write(sent);
    const long written = of_this_thread;
    std::size_t got = 0;
    const auto patience = std::chrono::steady_clock::now() + 100ms;
    long waited = 0;
    while (got == 0 && std::chrono::steady_clock::now() < patience) {
      const long asleep = of_this_thread;
      news.wait(50ms);
      waited += of_this_thread - asleep;
      got = reader.take_newest(taken);
    }
    in_write += written - before;
    in_wait += waited;
    in_take += of_this_thread - written - waited;
    if (got == 0) ++missed;
  }
  const long all = of_all_threads - all_before;
  const auto a_frame = [&](long n) {
    return static_cast<double>(n) / static_cast<double>(options.frames);
  };
  return {{"write", a_frame(in_write)},
          {"wait", a_frame(in_wait)},
          {"take", a_frame(in_take)},
          {"fast_dds_threads", a_frame(all - in_write - in_wait - in_take)},
          {"missed", missed}};
}

/// Fast DDS hands messages over inside a process unless a profiles file of this name says not to.
void force_transports(const bench::Folder& folder) {
  const std::string file = folder / "transports.xml";
  std::ofstream(file) << R"(<?xml version="1.0" encoding="UTF-8" ?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <library_settings><intraprocess_delivery>OFF</intraprocess_delivery></library_settings>
</dds>
)";
  ::setenv("FASTRTPS_DEFAULT_PROFILES_FILE", file.c_str(), 1);
}

int measure(int argc, char** argv) {
  CLI::App app{"Calls of malloc that Fast DDS makes to carry one pose"};
  Options options;
  bool transports = false, json = false;
  app.add_option("--frames", options.frames, "counted, at 62.5 Hz")->capture_default_str();
  app.add_option("--domain", options.domain)->capture_default_str();
  app.add_flag("--transports", transports, "as between processes");
  app.add_flag("--json", json);
  CLI11_PARSE(app, argc, argv);
  spdlog::set_level(spdlog::level::warn);

  const bench::Folder folder;
  if (transports) force_transports(folder);
  nlohmann::json result = run(options);
  const std::string way =
      transports ? "through UDP on the loopback" : "handed over inside the process";
  result["way"] = way;
  if (json) {
    fmt::print("{}\n", result.dump(2));
    return 0;
  }
  fmt::print(
      "{}: calls of malloc a frame: write {:.2f}, wait {:.2f}, take {:.2f}, Fast DDS's own "
      "threads {:.2f}; {} frames missed\n",
      way, result["write"].get<double>(), result["wait"].get<double>(),
      result["take"].get<double>(), result["fast_dds_threads"].get<double>(),
      result["missed"].get<long>());
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return measure(argc, argv);
  } catch (const std::exception& error) {
    fmt::print(stderr, "dds_allocation_bench: {}\n", error.what());
    return 1;
  }
}
