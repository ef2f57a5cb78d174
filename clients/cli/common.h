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
#include "clients/recorder/coach_replay.h"
#include "coach/coach_service.h"
#include "motion/retarget.h"
#include "server/open_source.h"
#include "server/wearable/wearable_topics.h"

/// What the subcommands share: options, the files that come with the program, ending on a signal.
namespace secondskin::cli {

/// What `train` teaches when nobody says otherwise.
inline constexpr const char* kDefaultReference = "deep_squat";

/// Options of every command that joins the bus.
struct BusOptions {
  bus::Config config;
  /// With the QoS file found, and a name for others to see.
  bus::Config configuration(std::string program) const;
};
void add_bus_options(CLI::App& command, BusOptions& options);

/// The files that come with the program, and the user's own beside them.
class Library {
 public:
  /// $SECONDSKIN_DATA, else ../share/secondskin beside the program, else the source tree.
  /// @throws std::runtime_error listing where it looked.
  Library();

  std::filesystem::path root() const { return root_; }
  std::filesystem::path qos() const { return root_ / "idl" / "qos.xml"; }
  std::filesystem::path idl() const { return root_ / "idl" / "secondskin_msgs.idl"; }
  /// The dashboard's built page: "dashboard" of an installation, else where the source tree builds
  /// it.
  std::filesystem::path page() const;
  std::filesystem::path joint_maps() const { return root_ / "joint_maps"; }
  std::filesystem::path marker_sets() const { return root_ / "marker_sets"; }
  /// By name, or a path to a .toml file. @throws std::runtime_error listing the names.
  std::filesystem::path find_suit(const std::string& name_or_path) const;
  /// As find_suit, under garments/.
  std::filesystem::path find_garment(const std::string& name_or_path) const;
  /// A wand or grid; as find_suit.
  std::filesystem::path find_calibration_object(const std::string& name_or_path) const;
  /// Where calibrations of an optical system are kept: $XDG_DATA_HOME/secondskin/optical.
  std::filesystem::path own_optical() const;
  /// Where calibrations of garments are kept, GARMENT.toml: $XDG_DATA_HOME/secondskin/wearable.
  std::filesystem::path own_wearable() const;
  /// Where `reference add` puts new ones: $XDG_DATA_HOME/secondskin/reference_motions.
  std::filesystem::path own_references() const;

  /// Where takes are kept until they are deleted: $XDG_DATA_HOME/secondskin/takes.
  std::filesystem::path own_takes() const;

  /// Where profiles of learners are kept, LEARNER.toml: $XDG_DATA_HOME/secondskin/learners.
  std::filesystem::path own_profiles() const;
  /// The history's database: $XDG_DATA_HOME/secondskin/history.db.
  std::filesystem::path own_history() const;

  /// Folders of all references: the default one first, of equal names the user's own only.
  std::vector<std::filesystem::path> references() const;
  /// By name, or a path to a folder or motion file. @throws std::runtime_error listing the names.
  std::filesystem::path find_reference(const std::string& name_or_path) const;
  /// Several performances of one motion, as --reference given more than once hands them over:
  /// names or paths with "+" between them.
  std::vector<std::filesystem::path> find_references(const std::string& names_or_paths) const;
  std::shared_ptr<const coach::Reference> load_reference(const std::string& names_or_paths) const;
  /// All of them, for a coach to choose from. One whose files are broken is left out with a
  /// warning.
  std::vector<std::shared_ptr<const coach::Reference>> load_references() const;
  /// By name, or a path to a .toml file. @throws std::runtime_error listing the names.
  coach::BodyMap load_body_map(const std::string& name_or_path) const;
  /// A session plan under plans/ by name, or a path to a .toml file; empty: practice without one.
  /// @throws std::runtime_error listing the names, or what is wrong in the file.
  coach::SessionPlan load_plan(const std::string& name_or_path) const;
  /// Lets a coach load what a session command names. From a command come names only, never paths.
  void answer_commands(coach::CoachServiceOptions& options) const;
  /// What a recording names, for its replay.
  recorder::ReplayLibrary for_replay() const;

 private:
  std::filesystem::path find_file(const char* kind, const char* folder,
                                  const std::string& name_or_path) const;

  std::filesystem::path root_;
};

/// What joins the values of a --reference that is given more than once.
inline constexpr char kPerformances = '+';

/// Options of every command that opens a SOURCE.
struct SourceOptions {
  std::string up;  ///< "", "y" or "z"
  std::optional<double> metres_per_unit;
  std::string suit = "full_body";
  std::filesystem::path projectors, body;  ///< empty: the ones in Library::own_optical()
  bool gray = false;
  std::string garment;  ///< name or file; empty: practical, and a table's own mapping
  std::filesystem::path wearer, wearable_calibration;
  double stature = 1.75, movement = 0.0;
  std::optional<double> temperature;
  bool no_contacts = false, smooth = false;

  RetargetOptions retarget() const;
  server::SourceSettings settings(const Library& library) const;
  /// As server::open_source, and "sim:SOURCE": a virtual optical system whose suit the body of
  /// another source wears.
  std::unique_ptr<server::PoseSource> open(const std::string& source, const Library& library) const;
};
/// What to name where a SOURCE is asked for.
inline constexpr const char* kSourceHelp =
    "FILE (.bvh, .mcap, .c3d, .trc, UI-PRMD .txt), optical:PORT,PORT..., "
    "wearable:FILE.garment, wearable:PORT, wearable:FILE.csv, mvn:PORT or sim:FILE";
void add_source_options(CLI::App& command, SourceOptions& options);
/// Those of sources without a worn garment: for commands that have a garment of their own.
void add_motion_options(CLI::App& command, SourceOptions& options);

/// The optical system behind a source; null where there is none.
server::OpticalSource* optical_of(server::PoseSource& source) noexcept;

/// What a wearable source gives beside poses: its topics. Nothing for another source.
class WearableOutputs {
 public:
  WearableOutputs(bus::Participant& participant, server::PoseSource& source);
  ~WearableOutputs();
  WearableOutputs(const WearableOutputs&) = delete;
  WearableOutputs& operator=(const WearableOutputs&) = delete;

 private:
  server::WearableSource* source_;
  std::unique_ptr<server::WearableTopics> topics_;
};

/// What an optical source gives beside poses: its topics, and its bytes in files when asked for.
/// Nothing for another source.
class OpticalOutputs {
 public:
  /// @param bytes  prefix of the byte files; empty: none
  /// @throws std::runtime_error when bytes are to be kept of a source that has none
  OpticalOutputs(bus::Participant& participant, server::PoseSource& source,
                 const std::string& bytes = {});
  ~OpticalOutputs();
  OpticalOutputs(const OpticalOutputs&) = delete;
  OpticalOutputs& operator=(const OpticalOutputs&) = delete;

  /// Says how the tags fared, and where the bytes are.
  void report() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// Sleeps until a source knows its body, saying why it does not. @returns false when a stop came
/// first.
bool wait_for_body(server::PoseSource& source, const std::string& name, std::stop_token stop);

/// Whether Enter was pressed on a terminal. Never waits.
bool enter_pressed();

/// Sleeps until a stop is asked for, or so many seconds are over.
void wait_for_stop(std::stop_token stop, double seconds);

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

/// --max-cues and --tolerance-scale, for the commands that coach.
void add_cue_options(CLI::App& command, coach::CoachSettings& settings);
/// --plan, for the same.
void add_plan_option(CLI::App& command, std::string& plan);
/// A line for each block: its repetitions, mean score and cues.
void print_blocks(const coach::CoachSummary& summary);

/// Degrees for people.
double deg(double radians);

/// "3.2 ms"
std::string milliseconds(double seconds);

// Each adds its commands to the program.
void add_train(CLI::App& app);
void add_services(CLI::App& app);
void add_virtual_tags(CLI::App& app);
void add_virtual_garment(CLI::App& app);
void add_suit(CLI::App& app);
void add_calibrate(CLI::App& app);
void add_calibrate_tactors(CLI::App& app);   ///< after add_calibrate()
void add_calibrate_wearable(CLI::App& app);  ///< after add_calibrate()
void add_files(CLI::App& app);
void add_reference(CLI::App& app);
void add_reference_record(CLI::App& reference);
void add_dashboard(CLI::App& app);
void add_stream(CLI::App& app);
void add_study(CLI::App& app);
void add_history(CLI::App& app);
void add_doctor(CLI::App& app);

}  // namespace secondskin::cli
