// Do the dashboard's clients slow the session down?
//
// A whole session runs as the real programs: capture of a recorded learner in a loop, coach, tactor
// driver, virtual board, and the dashboard. Rounds without clients and rounds with fifty idle
// clients, four that take everything and one that subscribes to everything and takes nothing
// alternate in one run. Two latencies: of each frame, from the pose's measurement to its command
// published, exactly; and to its bytes written to the board, the driver's own count of each second,
// whose steps are a third of the value. docs/dashboard.md quotes the output.

#include <fmt/core.h>
#include <poll.h>
#include <sys/resource.h>
#include <sys/socket.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket.hpp>
#include <nlohmann/json.hpp>
#include <regex>

#include "bench/live_session.h"
#include "bus/reader.h"
#include "bus/wait_set.h"

namespace {

using namespace secondskin;
using namespace std::chrono_literals;
namespace asio = boost::asio;
namespace beast = boost::beast;
namespace msg = bus::msg;

struct Options {
  std::size_t idle = 50;
  std::size_t active = 5;  ///< the last one of them is stuck
  std::size_t rounds = 3;
  double seconds = 10.0;
  std::uint32_t domain = 10 + static_cast<std::uint32_t>(::getpid()) % 90;
  bool json = false;
};

/// A page: connected, and subscribed to everything if it wants.
class Client {
 public:
  Client(std::uint16_t port, bool subscribes) : stream_(io_) {
    auto& socket = stream_.next_layer();
    socket.connect({asio::ip::address_v4::loopback(), port});
    stream_.set_option(beast::websocket::stream_base::decorator([](auto& request) {
      request.set(beast::http::field::sec_websocket_protocol, "foxglove.websocket.v1");
    }));
    stream_.handshake("127.0.0.1", "/");
    if (!subscribes) return;
    nlohmann::json list = nlohmann::json::array();
    for (int channel = 1; channel <= 17; ++channel) {
      list.push_back({{"id", channel}, {"channelId", channel}});
    }
    const std::string text = nlohmann::json{{"op", "subscribe"}, {"subscriptions", list}}.dump();
    stream_.write(asio::buffer(text));
  }
  ~Client() { end(); }

  /// Reads on a thread of its own until end().
  void take_all() {
    thread_ = std::jthread([this] {
      // As if on another machine: after the session and the bridge.
      ::setpriority(PRIO_PROCESS, static_cast<id_t>(::gettid()), 19);
      beast::flat_buffer buffer;
      beast::error_code error;
      while (!error) {
        stream_.read(buffer, error);
        messages_ += error ? 0 : 1;
        bytes_ += buffer.size();
        buffer.clear();
      }
    });
  }
  void end() {
    ::shutdown(stream_.next_layer().native_handle(), SHUT_RDWR);
    if (thread_.joinable()) thread_.join();
  }
  std::uint64_t messages() const { return messages_; }
  std::uint64_t bytes() const { return bytes_; }

 private:
  asio::io_context io_;
  beast::websocket::stream<asio::ip::tcp::socket> stream_;
  std::atomic<std::uint64_t> messages_{0}, bytes_{0};
  std::jthread thread_;
};

struct Seconds {
  std::vector<double> p50, p99;  // of the driver, one a second [s]
  std::vector<double> command;   // of each frame [s]
  std::uint64_t messages = 0, bytes = 0;
  double time = 0.0;
};

struct Readers {
  explicit Readers(bus::Participant& participant)
      : health(participant, bus::Want::kEvery), commands(participant, bus::Want::kEvery) {}
  bus::Reader<msg::ServiceHealth> health;
  bus::Reader<msg::TactorCommand> commands;
};

void listen(Readers& readers, double seconds, Seconds* into) {
  auto& health = readers.health;
  bus::WaitSet news;
  news.attach(health);
  news.attach(readers.commands);
  msg::TactorCommand command;
  const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
  msg::ServiceHealth words;
  for (auto now = std::chrono::steady_clock::now(); now < end;
       now = std::chrono::steady_clock::now()) {
    news.wait(std::chrono::duration_cast<std::chrono::nanoseconds>(end - now));
    while (readers.commands.take(command)) {
      const auto& header = command.header();
      if (into == nullptr) continue;
      into->command.push_back(1e-9 * static_cast<double>(header.publish_ns() - header.stamp_ns()));
    }
    while (health.take(words)) {
      if (into == nullptr || words.service() != "tactors" || words.rate_hz() < 1.0) continue;
      into->p50.push_back(words.latency_p50());
      into->p99.push_back(words.latency_p99());
    }
  }
}

std::string wait_for(bench::Program& program, const std::regex& what) {
  const auto end = std::chrono::steady_clock::now() + 20s;
  std::smatch found;
  for (;;) {
    const std::string log = program.log();
    if (std::regex_search(log, found, what)) return found[1];
    if (std::chrono::steady_clock::now() > end || !program.running()) {
      throw std::runtime_error(fmt::format("{} did not start: {}", program.name(), log));
    }
    std::this_thread::sleep_for(10ms);
  }
}

void measure(const Options& options) {
  const bench::Folder folder;
  const std::string subject = fmt::format("bench_{}", ::getpid());
  const auto start = [&](std::vector<std::string> command, bool on_bus = true) {
    const std::string log = folder / (command.front() + ".log");
    if (on_bus) {
      command.insert(command.end(),
                     {"--domain", std::to_string(options.domain), "--subject", subject});
    }
    return bench::Program(std::move(command), log);
  };
  auto board = start({"virtual-board"}, false);
  const std::string port = wait_for(board, std::regex("port (\\S+)"));
  auto tactors = start({"tactors", "--port", port});
  auto coach = start({"coach", "--reference", "low_block", "--tolerance-scale", "0.2"});
  auto dashboard = start({"dashboard", "--port", "0"});
  const auto page = static_cast<std::uint16_t>(
      std::stoi(wait_for(dashboard, std::regex("http://127.0.0.1:([0-9]+)/"))));
  auto capture = start(
      {"capture", (bench::kRoot / "reference_motions/low_block/learner.bvh").string(), "--loop"});

  bus::Participant participant({.subject = subject,
                                .domain = options.domain,
                                .qos_file = bench::kRoot / "idl" / "qos.xml",
                                .name = "secondskin_dashboard_bench"});
  Readers readers(participant);
  listen(readers, 6.0, nullptr);  // start-up

  std::array<Seconds, 2> found;
  for (std::size_t round = 0; round < options.rounds; ++round) {
    for (const bool busy : {false, true}) {
      std::vector<std::unique_ptr<Client>> clients;
      if (busy) {
        for (std::size_t i = 0; i < options.idle; ++i) {
          clients.push_back(std::make_unique<Client>(page, false));
        }
        for (std::size_t i = 0; i < options.active; ++i) {
          clients.push_back(std::make_unique<Client>(page, true));
          if (i + 1 < options.active) clients.back()->take_all();
        }
      }
      listen(readers, 2.0, nullptr);  // a second that saw both is nobody's
      const auto counted = [&] {
        std::pair<std::uint64_t, std::uint64_t> sum{0, 0};
        for (const auto& client : clients) {
          sum.first += client->messages();
          sum.second += client->bytes();
        }
        return sum;
      };
      const auto before = counted();
      listen(readers, options.seconds, &found[busy]);
      const auto after = counted();
      found[busy].messages += after.first - before.first;
      found[busy].bytes += after.second - before.second;
      found[busy].time += options.seconds;
    }
  }
  if (found[0].p50.empty() || found[1].p50.empty()) {
    throw std::runtime_error("the tactor driver wrote nothing");
  }
  const auto median = [](const std::vector<double>& values) {
    return 1e3 * bench::quantile(values, 0.5);
  };
  const double ratio_p50 = median(found[1].p50) / median(found[0].p50);
  const double ratio_p99 = median(found[1].p99) / median(found[0].p99);
  if (options.json) {
    nlohmann::json out{{"idle", options.idle},
                       {"active", options.active},
                       {"ratio_p50", ratio_p50},
                       {"ratio_p99", ratio_p99}};
    for (const bool busy : {false, true}) {
      const Seconds& s = found[busy];
      out["rows"].push_back({{"clients", busy ? options.idle + options.active : 0},
                             {"seconds", s.p50.size()},
                             {"frames", s.command.size()},
                             {"command_p50_ms", median(s.command)},
                             {"command_p99_ms", 1e3 * bench::quantile(s.command, 0.99)},
                             {"p50_ms", median(s.p50)},
                             {"p99_ms", median(s.p99)},
                             {"worst_p99_ms", 1e3 * bench::quantile(s.p99, 1.0)},
                             {"messages_per_s", static_cast<double>(s.messages) / s.time},
                             {"bytes_per_s", static_cast<double>(s.bytes) / s.time}});
    }
    fmt::print("{}\n", out.dump(2));
    return;
  }
  const auto name = [&](bool busy) {
    return busy ? fmt::format("{} idle clients, {} active, one of them stuck", options.idle,
                              options.active)
                : std::string("no client");
  };
  fmt::print("pose measured -> command published\n{:<44} {:>7} {:>8} {:>8} {:>10}   ms\n", "",
             "frames", "p50", "p99", "max");
  for (const bool busy : {false, true}) {
    const auto& values = found[busy].command;
    fmt::print("{:<44} {:>7} {:>8.3f} {:>8.3f} {:>10.3f}\n", name(busy), values.size(),
               median(values), 1e3 * bench::quantile(values, 0.99),
               1e3 * bench::quantile(values, 1.0));
  }
  fmt::print("ratio of the medians {:.2f}\n\n",
             median(found[1].command) / median(found[0].command));
  fmt::print("pose measured -> bytes written to the board, by the driver's count of each second\n");
  fmt::print("{:<44} {:>7} {:>8} {:>8} {:>10}   ms\n", "", "seconds", "p50", "p99", "worst p99");
  for (const bool busy : {false, true}) {
    const Seconds& s = found[busy];
    fmt::print("{:<44} {:>7} {:>8.3f} {:>8.3f} {:>10.3f}\n", name(busy), s.p50.size(),
               median(s.p50), median(s.p99), 1e3 * bench::quantile(s.p99, 1.0));
  }
  fmt::print(
      "ratio of the medians: p50 {:.2f}, p99 {:.2f}; sent: {:.0f} messages, {:.2f} MB a second\n",
      ratio_p50, ratio_p99, static_cast<double>(found[1].messages) / found[1].time,
      1e-6 * static_cast<double>(found[1].bytes) / found[1].time);
  fmt::print("{}", dashboard.end());
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"The session's latency with and without clients of the dashboard"};
  Options options;
  app.add_option("--idle", options.idle, "clients that only listen")->capture_default_str();
  app.add_option("--active", options.active, "clients that take everything; the last is stuck")
      ->check(CLI::Range(1, 40))
      ->capture_default_str();
  app.add_option("--rounds", options.rounds, "of each kind")->capture_default_str();
  app.add_option("--seconds", options.seconds, "counted in each round")->capture_default_str();
  app.add_option("--domain", options.domain)->capture_default_str();
  app.add_flag("--json", options.json);
  CLI11_PARSE(app, argc, argv);
  try {
    measure(options);
    return 0;
  } catch (const std::exception& error) {
    fmt::print(stderr, "dashboard_bench: {}\n", error.what());
    return 1;
  }
}
