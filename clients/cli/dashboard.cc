#include <fmt/format.h>

#include "clients/cli/dashboard_options.h"

namespace secondskin::cli {

void add_dashboard(CLI::App& app) {
  struct Options {
    BusOptions bus;
    PageOptions page;
  };
  auto options = std::make_shared<Options>();
  auto* command = app.add_subcommand(
      "dashboard", "serve the page, and all topics to it, Foxglove and others over WebSocket");
  command->footer(
      "Example:  secondskin dashboard\n"
      "          secondskin dashboard --bind 0.0.0.0 --allow-origin https://app.foxglove.dev\n"
      "Then open the address that it prints. Foxglove and Lichtblick connect to ws://HOST:PORT.");
  add_page_options(*command, options->page, "--port");
  add_bus_options(*command, options->bus);
  command->callback([options] {
    StopOnSignal signals;
    const Library library;
    bus::Participant participant(options->bus.configuration("secondskin_dashboard"));
    const SessionHistory history(participant, options->page, library);
    const TakeRecording takes(participant, library);
    auto prepared = options->page.prepare(options->bus.config.subject, library);
    prepared.handlers.push_back(takes.handler());
    dashboard::DashboardService service(participant, prepared);
    fmt::print("dashboard: {}\n", page_address(prepared, service.port()));
    std::fflush(stdout);
    const auto counts = service.run(signals.token());
    fmt::print("dashboard: {} messages, {} slow clients closed, {} requests refused\n",
               counts.messages, counts.web.dropped, counts.web.refused);
  });
}

}  // namespace secondskin::cli
