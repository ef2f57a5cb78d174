#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <chrono>
#include <map>

#include "bus/reader.h"
#include "bus/wait_set.h"
#include "bus/writer.h"
#include "clients/cli/common.h"
#include "clients/cli/tactile_options.h"
#include "clients/recorder/recorder_service.h"
#include "clients/tactor_driver/tactor_service.h"
#include "coach/coach_service.h"
#include "server/capture_service.h"
#include "server/mvn/mvn_source.h"
#include "server/open_source.h"
#include "sim/board/virtual_board_runner.h"

/// The services as commands, one process each. They find each other over DDS, started in any order.
namespace secondskin::cli {
namespace {

void capture(CLI::App& app) {
  struct Options {
    BusOptions bus;
    SourceOptions from;
    server::CaptureOptions capture;
    bool fast = false;
    std::string bytes;
  };
  auto options = std::make_shared<Options>();
  auto* command = app.add_subcommand("capture", "run a source and publish its poses");
  command->footer(
      "Example:  secondskin capture replay:squat.bvh --loop --speed 0.5\n"
      "          secondskin capture optical:/dev/ttyUSB0,/dev/ttyUSB1 --suit second_skin\n"
      "          secondskin capture wearable:walk.csv --garment walk_columns.toml --stature 1.82\n"
      "          secondskin capture mvn:9763");
  command->add_option("source", options->capture.source_name, kSourceHelp)->required();
  command->add_option("--speed", options->capture.speed, "times the source's own rate")
      ->check(CLI::Range(0.01, 100.0))
      ->capture_default_str();
  command->add_flag("--fast", options->fast, "as fast as it can go");
  command->add_flag("--loop", options->capture.loop, "start again at the end");
  command->add_option("--wait-for", options->capture.wait_for_readers,
                      "begin when so many programs read the poses (at most 5 s later)");
  command->add_option("--save-bytes", options->bytes,
                      "optical: keep the tags' bytes in PREFIX0.tag, PREFIX1.tag, ...");
  add_source_options(*command, options->from);
  add_bus_options(*command, options->bus);
  command->callback([options] {
    StopOnSignal signals;
    if (options->fast) options->capture.speed = 0.0;
    auto source = options->from.open(options->capture.source_name, Library());
    bus::Participant participant(options->bus.configuration("secondskin_capture"));
    const OpticalOutputs optical(participant, *source, options->bytes);
    const WearableOutputs wearable(participant, *source);
    server::CaptureService service(participant, *source, options->capture);
    spdlog::info("capture: {} at {:g} Hz, subject '{}', domain {}", options->capture.source_name,
                 source->rate_hz(), options->bus.config.subject, options->bus.config.domain);
    const auto counts = service.run(signals.token());
    fmt::print("capture: {} poses published, {} refused, {} late\n", counts.published,
               counts.refused, counts.late);
    optical.report();
    if (const auto* mvn = dynamic_cast<const server::MvnSource*>(source.get())) {
      const auto& seen = mvn->stream().counts();
      fmt::print(
          "mvn: {} samples lost, {} late, {} incomplete, {} datagrams garbled, {} of other "
          "types, {} of other avatars\n",
          seen.lost, seen.late, seen.incomplete, seen.all_garbled(), seen.other_types,
          seen.other_avatars);
    }
  });
}

void coach(CLI::App& app) {
  struct Options {
    BusOptions bus;
    std::string reference = "all";
    std::string body_map = "full_body";
    coach::CoachSettings settings;
    TactileOptions tactile;
    std::string plan;
    bool wait = false;
  };
  auto options = std::make_shared<Options>();
  auto* command =
      app.add_subcommand("coach", "follow a learner in a reference and cue corrections");
  command->footer("Example:  secondskin coach --reference squat --max-cues 1");
  command
      ->add_option(
          "--reference", options->reference,
          "name under reference_motions/, a folder or a motion file; 'all': every known one, "
          "to choose from by session commands; given more than once: performances of one motion")
      ->join(kPerformances)
      ->capture_default_str();
  command->add_option("--body-map", options->body_map, "where the tactors sit: name or .toml file")
      ->capture_default_str();
  add_cue_options(*command, options->settings);
  add_plan_option(*command, options->plan);
  command->add_flag("--wait", options->wait, "begin only when a session command says so");
  add_tactile_options(*command, options->tactile);
  add_bus_options(*command, options->bus);
  command->callback([options] {
    StopOnSignal signals;
    const Library library;
    coach::CoachServiceOptions service_options;
    if (options->reference == "all") {
      service_options.references = library.load_references();
    } else {
      service_options.references.push_back(library.load_reference(options->reference));
    }
    service_options.body_map = library.load_body_map(options->body_map);
    service_options.plan = library.load_plan(options->plan);
    service_options.settings = options->settings;
    service_options.tactile = options->tactile.prepare(service_options.body_map);
    library.answer_commands(service_options);
    const coach::BodyMap body_map = service_options.body_map;
    service_options.start = !options->wait;
    bus::Participant participant(options->bus.configuration("secondskin_coach"));
    coach::CoachService service(participant, std::move(service_options));
    const auto summary = service.run(signals.token());
    options->tactile.keep(body_map, summary.exposure);
    fmt::print("coach: {} frames, {} lost, {} repetitions, {} cues, {} corrections\n",
               summary.frames, summary.lost, summary.repetitions.size(), summary.cues,
               summary.corrections);
    if (!options->plan.empty()) print_blocks(summary);
  });
}

void tactors(CLI::App& app) {
  struct Options {
    BusOptions bus;
    tactor_driver::TactorOptions tactors;
  };
  auto options = std::make_shared<Options>();
  auto* command = app.add_subcommand("tactors", "drive a tactor board on a serial port");
  command->footer("Example:  secondskin tactors --port /dev/ttyUSB0");
  command->add_option("--port", options->tactors.port, "serial device or pseudo-terminal")
      ->required();
  command->add_option("--baud", options->tactors.baud_rate, "baud rate")->capture_default_str();
  add_bus_options(*command, options->bus);
  command->callback([options] {
    StopOnSignal signals;
    bus::Participant participant(options->bus.configuration("secondskin_tactors"));
    tactor_driver::TactorService service(participant, options->tactors);
    const auto summary = service.run(signals.token());
    fmt::print("tactors: {} commands, {} pairs sent, {} lapses, latency p50 {} p99 {}\n",
               summary.counters.taken, summary.counters.pairs, summary.counters.lapses,
               milliseconds(summary.latency.quantile(0.5)),
               milliseconds(summary.latency.quantile(0.99)));
  });
}

void virtual_board(CLI::App& app) {
  struct Options {
    std::string link;
    std::string waveform;
    std::string kind = "voice_coil";
  };
  auto options = std::make_shared<Options>();
  auto* command = app.add_subcommand(
      "virtual-board", "a tactor board of software on a pseudo-terminal, where none is attached");
  command->footer("Example:  secondskin virtual-board --link /tmp/board --waveform drive.csv");
  command->add_option("--link", options->link, "a name for its port, e.g. /tmp/board");
  command->add_option("--waveform", options->waveform,
                      "record each tactor's drive to this CSV file");
  command->add_option("--actuator", options->kind, "what is attached to it")
      ->check(CLI::IsMember({"voice_coil", "dc_motor"}))
      ->capture_default_str();
  command->callback([options] {
    StopOnSignal signals;
    wire::PseudoTerminal terminal(options->link);
    std::optional<sim::WaveformRecorder> recorder;
    if (!options->waveform.empty()) recorder.emplace(options->waveform);
    sim::VirtualBoardConfig config;
    config.actuators.fill(options->kind == "dc_motor" ? wire::Actuator::kDcMotor
                                                      : wire::Actuator::kVoiceCoil);
    sim::VirtualBoardRunner board(terminal, config, [&recorder](const sim::BoardSample& sample) {
      if (recorder) recorder->record(sample);
    });
    fmt::print("port {}\n", terminal.path());
    std::fflush(stdout);
    board.run(signals.token());
    const auto counters = board.counters();
    fmt::print("virtual board: {} commands, {} bytes dropped, {} watchdog trips\n",
               counters.commands, counters.dropped_bytes, counters.watchdog_trips);
  });
}

void record(CLI::App& app) {
  struct Options {
    BusOptions bus;
    std::filesystem::path file;
  };
  auto options = std::make_shared<Options>();
  auto* command = app.add_subcommand("record", "write everything that travels into a recording");
  command->footer("Example:  secondskin record session.mcap");
  command->add_option("file", options->file, "the recording to make (.mcap)")->required();
  add_bus_options(*command, options->bus);
  command->callback([options] {
    StopOnSignal signals;
    bus::Participant participant(options->bus.configuration("secondskin_recorder"));
    recorder::RecorderService service(participant, {options->file, Library().idl()});
    spdlog::info("recording to {}", options->file.string());
    const auto counts = service.run(signals.token());
    fmt::print("record: {} messages, {} bytes, {} lost, in {}\n", counts.messages, counts.bytes,
               counts.lost, options->file.string());
    if (!counts.error.empty()) throw std::runtime_error(counts.error);
  });
}

/// Sleeps until what a reader gets answers a question, or `at_most` is over. @returns whether it
/// did.
template <class Answered>
bool wait_for(bus::ReaderBase& answers, std::chrono::nanoseconds at_most, std::stop_token stop,
              Answered answered) {
  using Clock = std::chrono::steady_clock;
  bus::WaitSet news;
  news.attach(answers);
  const std::stop_callback wake(stop, [&news] { news.wake(); });
  const auto end = Clock::now() + at_most;
  for (auto now = Clock::now(); now < end && !stop.stop_requested(); now = Clock::now()) {
    if (answered()) return true;
    news.wait(end - now);
  }
  return answered();
}

void stop(CLI::App& app) {
  struct Options {
    BusOptions bus;
    std::string reason = "asked on the command line";
    bool lift = false;
  };
  auto options = std::make_shared<Options>();
  auto* command =
      app.add_subcommand("stop", "turn all vibration off, at once and until it is lifted");
  command->footer("Example:  secondskin stop --reason \"learner is tired\"");
  command->add_option("--reason", options->reason, "why, for the record")->capture_default_str();
  command->add_flag("--lift", options->lift, "allow vibration again");
  add_bus_options(*command, options->bus);
  command->callback([options] {
    using namespace std::chrono_literals;
    StopOnSignal signals;
    bus::Participant participant(options->bus.configuration("secondskin_stop"));
    bus::Writer<bus::msg::EmergencyStop> writer(participant);
    bus::Reader<bus::msg::EmergencyStop> repeated(participant, bus::Want::kEvery);
    bus::msg::EmergencyStop message, answer;
    message.active(!options->lift);
    message.reason(options->reason.substr(0, 128));
    message.publish_ns(bus::now_ns());
    // Driver and coach repeat what they obey (bus/stop_state.h); our own word comes back, too.
    std::size_t heard = 0;
    const auto count = [&] {
      while (repeated.take(answer)) heard += answer.publish_ns() == message.publish_ns() ? 1 : 0;
      return heard >= 2;
    };
    writer.write(message);
    wait_for(repeated, 3s, signals.token(), count);
    // The driver and the coach are found one after the other, and whoever is missed by a lift would
    // stay stopped.
    wait_for(repeated, 1s, signals.token(), [&] {
      count();
      return false;
    });
    if (heard < 2) {
      throw std::runtime_error(
          fmt::format("nobody obeys: no tactor driver and no coach on subject '{}', domain {}",
                      options->bus.config.subject, options->bus.config.domain));
    }
    fmt::print("{}\n", options->lift ? "vibration is allowed again" : "all vibration is off");
  });
}

void session(CLI::App& app) {
  struct Options {
    BusOptions bus;
    std::string action;
    std::string reference;
    double tolerance_scale = 0.0;
    std::uint32_t max_cues = 0;
    std::string plan, learner;
  };
  auto options = std::make_shared<Options>();
  auto* command = app.add_subcommand("session", "start, pause, resume or stop a coach's session");
  command->footer("Example:  secondskin session start --reference squat");
  command->add_option("action", options->action, "start, pause, resume or stop")
      ->required()
      ->check(CLI::IsMember({"start", "pause", "resume", "stop"}));
  command->add_option("--reference", options->reference,
                      "with start: one that the coach knows (default: as before)");
  command
      ->add_option("--tolerance-scale", options->tolerance_scale,
                   "with start: times the reference's tolerances (default: as before)")
      ->check(CLI::Range(0.1, 10.0));
  command
      ->add_option("--max-cues", options->max_cues,
                   "with start: joints cued at once (default: as before)")
      ->check(CLI::Range(1, 16));
  command->add_option("--plan", options->plan,
                      "with start: a session plan by name, or 'none' (default: as before)");
  command->add_option("--learner", options->learner,
                      "with start: whom the history books the session to (default: as before)");
  add_bus_options(*command, options->bus);
  command->callback([options] {
    using namespace std::chrono_literals;
    namespace msg = bus::msg;
    StopOnSignal signals;
    bus::Participant participant(options->bus.configuration("secondskin_session"));
    bus::Writer<msg::SessionCommand> writer(participant);
    bus::Reader<msg::SessionState> states(participant, bus::Want::kEvery);
    bus::Reader<msg::ServiceHealth> health(participant, bus::Want::kEvery);
    const std::map<std::string, std::pair<msg::SessionAction, msg::SessionPhase>> actions{
        {"start", {msg::SESSION_START, msg::SESSION_RUNNING}},
        {"pause", {msg::SESSION_PAUSE, msg::SESSION_PAUSED}},
        {"resume", {msg::SESSION_RESUME, msg::SESSION_RUNNING}},
        {"stop", {msg::SESSION_STOP, msg::SESSION_ENDED}}};
    const auto [action, wanted] = actions.at(options->action);
    msg::SessionCommand order;
    order.action(action);
    order.reference(options->reference.substr(0, 64));
    order.tolerance_scale(options->tolerance_scale);
    order.max_cues(options->max_cues);
    order.plan(options->plan.substr(0, 64));
    order.learner(options->learner.substr(0, 64));
    order.publish_ns(bus::now_ns());
    if (!writer.wait_for_readers(1, 3s, signals.token())) {
      throw std::runtime_error(fmt::format("no coach on subject '{}', domain {}",
                                           options->bus.config.subject,
                                           options->bus.config.domain));
    }
    msg::SessionState state;
    msg::ServiceHealth complaint;
    writer.write(order);
    const bool obeyed = wait_for(states, 5s, signals.token(), [&, wanted = wanted] {
      bool done = false;
      while (states.take(state)) {
        done =
            done || (state.phase() == wanted && state.header().publish_ns() >= order.publish_ns());
      }
      return done;
    });
    while (health.take(complaint)) {
      if (!obeyed && complaint.service().to_string() == "coach" &&
          complaint.state() == msg::SERVICE_FAULT) {
        throw std::runtime_error("the coach says: " + complaint.message().to_string());
      }
    }
    if (!obeyed) throw std::runtime_error("the coach did not answer within 5 s");
    fmt::print("session: {} '{}'\n", options->action, state.reference().to_string());
  });
}

}  // namespace

void add_services(CLI::App& app) {
  capture(app);
  coach(app);
  tactors(app);
  record(app);
  virtual_board(app);
  stop(app);
  session(app);
}

}  // namespace secondskin::cli
