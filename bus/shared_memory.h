#pragma once

#include <cstddef>
#include <filesystem>

namespace secondskin::bus {

struct ShmCleaning {
  std::size_t removed = 0;  ///< segments of dead processes that were removed
  std::size_t in_use = 0;
  std::size_t refused = 0;  ///< dead, but belonging to another user
};

/// Removes the shared-memory segments that killed Fast DDS processes left behind; they would block
/// later runs. A segment is dead when nobody holds the lock on the file beside it ("_el").
ShmCleaning remove_stale_shared_memory(const std::filesystem::path& folder = "/dev/shm");

}  // namespace secondskin::bus
