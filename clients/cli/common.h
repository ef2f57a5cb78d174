#pragma once

#include <CLI/CLI.hpp>
#include <filesystem>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include "bus/participant.h"
#include "coach/coach.h"
#include "motion/retarget.h"

/// What the subcommands share: options, the files that come with the program, ending on a signal.
namespace secondskin::cli {

/// What `train` teaches when nobody says otherwise.
inline constexpr const char* kDefaultReference = "low_block";

/// Options of every command that joins the bus.
struct BusOptions {
  bus::Config config;
  /// With the QoS file found, and a name for others to see.
  bus::Config configuration(std::string program) const;
};
void add_bus_options(CLI::App& command, BusOptions& options);

/// Options of every command that reads motion files.
struct FileOptions {
  std::string up;  ///< "", "y" or "z"
  std::optional<double> metres_per_unit;
  RetargetOptions retarget() const;
};
void add_file_options(CLI::App& command, FileOptions& options);

/// The files that come with the program, and the user's own beside them.
class Library {
 public:
  /// $SECONDSKIN_DATA, else ../share/secondskin beside the program, else the source tree.
  /// @throws std::runtime_error listing where it looked.
  Library();

  std::filesystem::path root() const { return root_; }
  std::filesystem::path qos() const { return root_ / "idl" / "qos.xml"; }
  std::filesystem::path idl() const { return root_ / "idl" / "secondskin_msgs.idl"; }
  std::filesystem::path joint_maps() const { return root_ / "joint_maps"; }
  /// Where `reference add` puts new ones: $XDG_DATA_HOME/secondskin/reference_motions.
  std::filesystem::path own_references() const;

  /// Folders of all references: the default one first, of equal names the user's own only.
  std::vector<std::filesystem::path> references() const;
  /// By name, or a path to a folder or motion file. @throws std::runtime_error listing the names.
  std::filesystem::path find_reference(const std::string& name_or_path) const;
  std::shared_ptr<const coach::Reference> load_reference(const std::string& name_or_path) const;
  /// By name, or a path to a .toml file. @throws std::runtime_error listing the names.
  coach::BodyMap load_body_map(const std::string& name_or_path) const;

 private:
  std::filesystem::path root_;
};

/// Asks for a stop when the process gets SIGINT or SIGTERM. Make it before any thread.
class StopOnSignal {
 public:
  StopOnSignal();
  ~StopOnSignal();
  std::stop_token token() const { return source_.get_token(); }
  std::stop_source& source() { return source_; }

 private:
  std::stop_source source_;
  int end_fd_ = -1;
  std::thread thread_;
};

std::string default_recording_name(const std::string& reference);

/// Degrees for people.
double deg(double radians);

/// "3.2 ms"
std::string milliseconds(double seconds);

// Each adds its commands to the program.
void add_train(CLI::App& app);
void add_services(CLI::App& app);
void add_files(CLI::App& app);
void add_reference(CLI::App& app);
void add_doctor(CLI::App& app);

}  // namespace secondskin::cli
