#pragma once

#include <filesystem>

namespace secondskin::authoring {

/// A folder under the system's temporary one, for as long as the object.
class Scratch {
 public:
  /// @throws std::system_error naming the folder that cannot be made.
  Scratch();
  ~Scratch();
  Scratch(const Scratch&) = delete;
  Scratch& operator=(const Scratch&) = delete;

  const std::filesystem::path& folder() const { return folder_; }

 private:
  std::filesystem::path folder_;
};

}  // namespace secondskin::authoring
