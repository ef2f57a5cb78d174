#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <mutex>
#include <string>
#include <vector>

#include "clients/authoring/cut.h"
#include "motion/motion.h"
#include "motion/retarget.h"

/// Takes: performances that were recorded or imported, kept on disk until they are deleted, so that
/// a crash or a page that is loaded anew loses nothing that was finished. A store may be used by
/// several threads.
namespace secondskin::authoring {

/// A stretch of a take that may go into a reference.
struct Part {
  Span span;
  bool chosen = true;
};

/// What is known of a take beside its poses.
struct TakeInfo {
  std::string id;                   ///< a name of this store, safe in paths
  std::int64_t recorded_ns = 0;     ///< since the Unix epoch
  std::string source;               ///< what yielded the poses, e.g. "replay:kick.bvh"
  std::vector<std::string> faults;  ///< what went wrong while it was recorded, for people
  double duration = 0.0;            ///< [s]
  double rate_hz = 0.0;
  Cutting cutting;          ///< as found
  std::vector<Part> parts;  ///< as found, until set_parts()
};

struct Take {
  TakeInfo info;
  Motion motion;  ///< canonical
};

class TakeStore {
 public:
  /// @param folder  made with the first take
  TakeStore(std::filesystem::path folder, std::filesystem::path joint_maps);

  /// Keeps a motion; it is whole on disk when this returns.
  /// @throws std::invalid_argument for a motion that cut() refuses, std::system_error naming the
  ///         file when the disk does.
  TakeInfo add(const Motion& canonical, const std::string& source, std::int64_t recorded_ns,
               std::vector<std::string> faults = {});

  /// Oldest first. A take whose files are broken is left out with a warning.
  std::vector<TakeInfo> list();

  /// @throws std::out_of_range naming the id when there is none.
  Take load(const std::string& id);
  void remove(const std::string& id);
  /// Cuts moved by hand. @throws std::invalid_argument naming the part that is not within the take
  ///                            or shorter than kShortestPart.
  TakeInfo set_parts(const std::string& id, std::vector<Part> parts);

 private:
  std::filesystem::path place(const std::string& id) const;
  TakeInfo read(const std::filesystem::path& folder) const;
  const TakeInfo& known(const std::string& id);
  void look();

  std::filesystem::path folder_;
  std::filesystem::path joint_maps_;
  std::mutex mutex_;
  std::map<std::string, TakeInfo> known_;
};

inline constexpr double kShortestPart = 0.3;  ///< [s]

/// A part's poses. @throws std::invalid_argument naming `what` unless it is within the motion and
/// at least kShortestPart long.
Motion part_of(const Motion& motion, const Span& span, const std::string& what);

}  // namespace secondskin::authoring
