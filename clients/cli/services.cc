#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <condition_variable>
#include <mutex>

#include "bus/writer.h"
#include "clients/cli/common.h"
#include "clients/recorder/recorder_service.h"
#include "clients/tactor_driver/tactor_service.h"
#include "coach/coach_service.h"
#include "server/capture_service.h"
#include "server/open_source.h"
#include "sim/board/virtual_board_runner.h"

/// The services as commands, one process each. They find each other over DDS, started in any order.
namespace secondskin::cli {
namespace {

void capture(CLI::App& app) {
  struct Options {
    BusOptions bus;
    FileOptions file;
    server::CaptureOptions capture;
    bool fast = false;
  };
  auto options = std::make_shared<Options>();
  auto* command = app.add_subcommand("capture", "run a source and publish its poses");
  command->footer("Example:  secondskin capture replay:squat.bvh --loop --speed 0.5");
  command->add_option("source", options->capture.source_name, "replay:FILE or FILE (.bvh, .mcap)")
      ->required();
  command->add_option("--speed", options->capture.speed, "times the source's own rate")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_flag("--fast", options->fast, "as fast as it can go");
  command->add_flag("--loop", options->capture.loop, "start again at the end");
  command->add_option("--wait-for", options->capture.wait_for_readers,
                      "begin when so many programs read the poses (at most 5 s later)");
  add_file_options(*command, options->file);
  add_bus_options(*command, options->bus);
  command->callback([options] {
    StopOnSignal signals;
    if (options->fast) options->capture.speed = 0.0;
    auto source = server::open_source(options->capture.source_name, Library().joint_maps(),
                                      options->file.retarget());
    bus::Participant participant(options->bus.configuration("secondskin_capture"));
    server::CaptureService service(participant, *source, options->capture);
    spdlog::info("capture: {} at {:g} Hz, subject '{}', domain {}", options->capture.source_name,
                 source->rate_hz(), options->bus.config.subject, options->bus.config.domain);
    const auto counts = service.run(signals.token());
    fmt::print("capture: {} poses published, {} refused, {} late\n", counts.published,
               counts.refused, counts.late);
  });
}

void coach(CLI::App& app) {
  struct Options {
    BusOptions bus;
    std::string reference = "all";
    std::string body_map = "full_body";
    coach::CoachSettings settings;
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
          "to choose from by session commands")
      ->capture_default_str();
  command->add_option("--body-map", options->body_map, "where the tactors sit: name or .toml file")
      ->capture_default_str();
  command->add_option("--max-cues", options->settings.max_cues, "joints cued at once")
      ->check(CLI::Range(1, 16))
      ->capture_default_str();
  command
      ->add_option("--tolerance-scale", options->settings.tolerance_scale,
                   "times the reference's tolerances")
      ->check(CLI::Range(0.1, 10.0))
      ->capture_default_str();
  command->add_flag("--wait", options->wait, "begin only when a session command says so");
  add_bus_options(*command, options->bus);
  command->callback([options] {
    StopOnSignal signals;
    const Library library;
    coach::CoachServiceOptions service_options;
    if (options->reference == "all") {
      for (const auto& folder : library.references()) {
        service_options.references.push_back(library.load_reference(folder.string()));
      }
    } else {
      service_options.references.push_back(library.load_reference(options->reference));
    }
    service_options.body_map = library.load_body_map(options->body_map);
    service_options.settings = options->settings;
    service_options.start = !options->wait;
    bus::Participant participant(options->bus.configuration("secondskin_coach"));
    coach::CoachService service(participant, std::move(service_options));
    const auto summary = service.run(signals.token());
    fmt::print("coach: {} frames, {} lost, {} repetitions, {} cues, {} corrections\n",
               summary.frames, summary.lost, summary.repetitions.size(), summary.cues,
               summary.corrections);
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

void stop(CLI::App& app) {
  struct Options {
    BusOptions bus;
    std::string reason = "command";
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
    bus::msg::EmergencyStop message;
    message.active(!options->lift);
    message.reason(options->reason.substr(0, 128));
    message.publish_ns(bus::now_ns());
    writer.write(message);  // each reader gets it as soon as it is found (transient local)
    if (!writer.wait_for_readers(1, 3s, signals.token())) {
      throw std::runtime_error(
          fmt::format("no tactor driver and no coach on subject '{}', domain {}: nothing to stop",
                      options->bus.config.subject, options->bus.config.domain));
    }
    // The driver, the coach and others are found one after the other; who is missed by a lift would
    // stay stopped.
    std::mutex mutex;
    std::condition_variable_any alarm;
    std::unique_lock lock(mutex);
    alarm.wait_for(lock, signals.token(), 1s, [] { return false; });
    if (!writer.wait_until_delivered(2s)) {
      throw std::runtime_error("somebody did not confirm; say it again");
    }
    fmt::print("{}\n", options->lift ? "vibration is allowed again" : "all vibration is off");
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
}

}  // namespace secondskin::cli
