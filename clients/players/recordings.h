#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <string_view>
#include <vector>

#include "clients/players/states.h"

/// The recordings in a folder.
namespace secondskin::players {

struct RecordingInfo {
  std::string name;  ///< of the file
  std::uint64_t bytes = 0;
  enum class State : std::uint8_t {
    kFinished,
    kBeingRecorded,  ///< not finished, and written to just now
    kUnfinished,     ///< its writer was killed: the index is missing
    kDamaged         ///< no recording, or nothing in it can be read
  };
  State state = State::kFinished;
  std::string error;    ///< of a damaged one
  std::string subject;  ///< of the topics' names
  std::int64_t start_ns = 0, end_ns = 0;
  std::uint64_t repetitions = 0;
  std::vector<std::string> references;
  bool coached = false;  ///< a coach's session is in it
  bool read = true;      ///< false: not finished, and nobody has read it since; see scan()
};

/// What became of a learner's recordings.
struct Forgotten {
  std::vector<std::string> removed;  ///< names
  struct Kept {
    std::string name, why;
  };
  std::vector<Kept> kept;  ///< theirs, or perhaps theirs
};

/// Any thread.
class Recordings {
 public:
  explicit Recordings(std::filesystem::path folder) : folder_(std::move(folder)) {}

  const std::filesystem::path& folder() const noexcept { return folder_; }

  /// Newest first. Quick: of what is not finished only what is known of it.
  std::vector<RecordingInfo> list();

  /// @param name  as in the list; anything that is not the plain name of a .mcap file in the folder
  /// is not found, links out of it included
  std::optional<std::filesystem::path> find(const std::string& name) const;
  /// What was read once is remembered as long as the file stays as it is.
  RecordingInfo describe(const std::filesystem::path& file);
  /// Reads what is not finished: the whole file.
  RecordingInfo scan(const std::filesystem::path& file);

  /// Removes the recordings with sessions of this learner, and all that was computed of any. One
  /// with sessions of another learner, too, is kept, as is one that is just being written. Reads
  /// those whole of which no states are kept. Nothing may be computed meanwhile.
  /// @throws std::runtime_error at a stop
  Forgotten forget(const std::string& learner, const Progress& progress = {},
                   std::stop_token stop = {});

  /// Where what is computed of recordings is kept; their states apart, since they are many.
  std::filesystem::path computed() const { return folder_ / ".players"; }
  std::filesystem::path states() const { return computed() / "states"; }
  /// Of what is computed of a file: another one for another content. A plain file name.
  static std::string key_of(const std::filesystem::path& file, std::string_view kind,
                            std::string_view more = {});
  static std::string digest(std::string_view text);  ///< 16 hexadecimal digits
  /// What is said to a client: where the folder is on this machine is of no interest to it.
  std::string without_folder(std::string words) const;

 private:
  struct Known {
    std::uint64_t bytes;
    std::filesystem::file_time_type written;
    RecordingInfo info;
  };
  RecordingInfo look(const std::filesystem::path& file, bool whole);
  Learners learners(const std::filesystem::path& file, std::stop_token stop) const;

  std::filesystem::path folder_;
  std::mutex mutex_;  // of what follows
  std::map<std::string, Known> known_;
};

}  // namespace secondskin::players
