// Opening a long recording: one of an hour is made of a real one, repeated, and its states are
// extracted as the bridge does it for the page.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>

#include "clients/players/states.h"
#include "recording/mcap_reader.h"
#include "recording/mcap_writer.h"

namespace {

namespace fs = std::filesystem;
using namespace secondskin;

/// The recording again and again, each time later. The times within the messages stay.
void lengthen(const fs::path& from, const fs::path& to, double seconds) {
  recording::McapReader reader(from);
  recording::McapWriter out(to);
  std::map<std::uint16_t, std::uint16_t> copies;
  for (const auto& c : reader.channels()) {
    copies[c.id] = out.add_channel(c.topic, c.schema_name, c.schema_encoding, c.schema_text,
                                   c.message_encoding);
  }
  const std::int64_t length = reader.end_ns() - reader.start_ns() + 1'000'000;
  const auto end = static_cast<std::int64_t>(seconds * 1e9);
  for (std::int64_t later = 0; later < end; later += length) {
    reader.for_each([&](const recording::McapMessage& raw) {
      out.write(copies.at(raw.channel), raw.sequence, raw.log_time_ns + later,
                raw.publish_time_ns + later, raw.data);
      return true;
    });
  }
  out.close();
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("extracts the states of a long recording that is made of a real one");
  fs::path from, folder;
  double seconds = 3600.0;
  bool as_json = false;
  app.add_option("RECORDING", from, "a finished recording of a session")->required();
  app.add_option("FOLDER", folder, "where long.mcap and states.mcap are left")->required();
  app.add_option("--seconds", seconds, "of the long one")->capture_default_str();
  app.add_flag("--json", as_json, "as JSON");
  CLI11_PARSE(app, argc, argv);
  try {
    fs::create_directories(folder);
    const fs::path whole = folder / "long.mcap", states = folder / "states.mcap";
    fs::remove(whole);
    fs::remove(states);
    lengthen(from, whole, seconds);
    const auto begin = std::chrono::steady_clock::now();
    players::write_states(whole, states);
    const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - begin;
    const recording::McapReader all(whole), kept(states);
    if (as_json) {
      fmt::print("{}\n", nlohmann::json{{"bytes", fs::file_size(whole)},
                                        {"messages", all.messages()},
                                        {"state_bytes", fs::file_size(states)},
                                        {"state_messages", kept.messages()},
                                        {"seconds", taken.count()}}
                             .dump(2));
    } else {
      fmt::print(
          "recording {:10.2f} MB {:9} messages\nstates    {:10.2f} MB {:9} messages, "
          "extracted in {:.2f} s\n",
          static_cast<double>(fs::file_size(whole)) * 1e-6, all.messages(),
          static_cast<double>(fs::file_size(states)) * 1e-6, kept.messages(), taken.count());
    }
  } catch (const std::exception& error) {
    fmt::print(stderr, "long_recording_bench: {}\n", error.what());
    return 1;
  }
  return 0;
}
