#include <fmt/format.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <csignal>
#include <cstdlib>
#include <string_view>

#include "clients/cli/common.h"
#include "clients/tactor_driver/guardian.h"

namespace {

int run(int argc, char** argv) {
  using namespace secondskin;
  CLI::App app{
      "Second Skin teaches movement through touch: it measures a learner, compares them live with "
      "an\n"
      "expert's motion, and vibrates where a correction helps most.\n\n"
      "Start with:  secondskin train\n"
      "Every command explains itself:  secondskin COMMAND --help",
      "secondskin"};
  app.set_version_flag("--version", SECONDSKIN_VERSION);
  app.set_config("--config", "secondskin.toml",
                 "a file that holds options, e.g.  [train]\\nreference = \"squat\"");
  app.require_subcommand(1);
  app.fallthrough();  // so that --config and -v may stand after the command, too
  app.allow_config_extras(CLI::config_extras_mode::error);
  app.add_flag_callback(
      "-v,--verbose", [] { spdlog::set_level(spdlog::level::debug); },
      "say more on standard error");
  cli::add_train(app);
  cli::add_services(app);
  cli::add_virtual_tags(app);
  cli::add_virtual_garment(app);
  cli::add_suit(app);
  cli::add_files(app);
  cli::add_reference(app);
  cli::add_calibrate(app);
  cli::add_calibrate_tactors(app);
  cli::add_calibrate_wearable(app);
  cli::add_dashboard(app);
  cli::add_stream(app);
  cli::add_study(app);
  cli::add_history(app);
  cli::add_doctor(app);
  if (argc > 1 && argv[1][0] != '-' &&
      app.get_subcommands([&](CLI::App* known) { return known->check_name(argv[1]); }).empty()) {
    fmt::print(stderr, "secondskin: '{}' is no command; run with --help to see them all\n",
               argv[1]);
    return EXIT_FAILURE;
  }
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error);
  }
  return EXIT_SUCCESS;
}

}  // namespace

int main(int argc, char** argv) {
  // The guardian is this program again; it must not do anything else first.
  if (argc == 4 && std::string_view(argv[1]) == secondskin::tactor_driver::kGuardianCommand &&
      std::string_view(argv[2]) == "--fd") {
    return secondskin::tactor_driver::guardian_main(std::atoi(argv[3]));
  }
  // A file that may not grow is an error to report, not a reason to die.
  std::signal(SIGXFSZ, SIG_IGN);
  spdlog::set_default_logger(spdlog::stderr_color_mt("secondskin"));
  spdlog::set_pattern("%^%l%$: %v");
  try {
    return run(argc, argv);
  } catch (const std::exception& error) {
    fmt::print(stderr, "secondskin: {}\n", error.what());
    return EXIT_FAILURE;
  }
}
