#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include "clients/cli/common.h"
#include "clients/stream/mvn_streamer.h"
#include "clients/stream/stream_service.h"
#include "clients/stream/vmc_performer.h"

/// `vmc` and `mvn`: poses for avatars and for programs that read an Xsens suit.
namespace secondskin::cli {
namespace {

struct Language {
  const char* name;
  const char* description;
  const char* footer;
  const char* to;
  std::unique_ptr<stream::PoseEncoder> (*encoder)(const std::string& subject);
};

void add_language(CLI::App& app, const Language& language) {
  struct Options {
    BusOptions bus;
    std::string to;
  };
  auto options = std::make_shared<Options>();
  options->to = language.to;
  auto* command = app.add_subcommand(language.name, language.description);
  command->footer(language.footer);
  command->add_option("--to", options->to, "PORT or ADDRESS:PORT that it sends to, over UDP")
      ->capture_default_str();
  add_bus_options(*command, options->bus);
  command->callback([options, language] {
    StopOnSignal signals;
    wire::UdpPlace to;
    try {
      to = wire::UdpPlace::parse(options->to);
    } catch (const std::invalid_argument& error) {
      throw std::runtime_error(fmt::format("--to {}", error.what()));
    }
    const std::string& subject = options->bus.config.subject;
    bus::Participant participant(
        options->bus.configuration(fmt::format("secondskin_{}", language.name)));
    stream::StreamService service(participant, language.name, language.encoder(subject), to);
    spdlog::info("{}: poses of subject '{}' to {}", language.name, subject, to.text());
    const auto counts = service.run(signals.token());
    fmt::print("{}: {} poses sent in {} datagrams, {} skipped, {} refused\n", language.name,
               counts.poses, counts.datagrams, counts.skipped, counts.refused);
  });
}

}  // namespace

void add_stream(CLI::App& app) {
  add_language(app,
               {"vmc", "send the poses to an avatar in Unity, Unreal or Blender (VMC protocol)",
                "Example:  secondskin vmc --to 127.0.0.1:39539", "127.0.0.1:39539",
                [](const std::string&) -> std::unique_ptr<stream::PoseEncoder> {
                  return std::make_unique<stream::VmcPerformer>();
                }});
  add_language(app, {"mvn", "send the poses as Xsens MVN's network streamer does",
                     "Example:  secondskin mvn --to 127.0.0.1:9763", "127.0.0.1:9763",
                     [](const std::string& subject) -> std::unique_ptr<stream::PoseEncoder> {
                       return std::make_unique<stream::MvnStreamer>(subject);
                     }});
}

}  // namespace secondskin::cli
