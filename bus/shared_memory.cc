#include "bus/shared_memory.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <string>
#include <vector>

namespace secondskin::bus {
namespace {

namespace fs = std::filesystem;
constexpr std::string_view kPrefix = "fastrtps_";
constexpr std::string_view kLockSuffix = "_el";

enum class Owner { kAlive, kDead, kNotOurs };

Owner owner_of(const fs::path& lock_file) {
  const int fd = ::open(lock_file.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) return errno == ENOENT ? Owner::kAlive : Owner::kNotOurs;
  // The owner holds this lock as long as it lives; the kernel lets go of it whatever ends it.
  const bool free = ::flock(fd, LOCK_EX | LOCK_NB) == 0;
  ::close(fd);
  return free ? Owner::kDead : Owner::kAlive;
}

}  // namespace

ShmCleaning remove_stale_shared_memory(const fs::path& folder) {
  ShmCleaning result;
  std::vector<fs::path> locks;
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error)) {
    const std::string name = it->path().filename().string();
    if (name.starts_with(kPrefix) && name.ends_with(kLockSuffix)) locks.push_back(it->path());
  }
  for (const auto& lock : locks) {
    switch (owner_of(lock)) {
      case Owner::kAlive:
        ++result.in_use;
        continue;
      case Owner::kNotOurs:
        ++result.refused;
        continue;
      case Owner::kDead:
        break;
    }
    const std::string name = lock.filename().string();
    const std::string segment = name.substr(0, name.size() - kLockSuffix.size());
    bool removed = fs::remove(folder / segment, error) && !error;
    fs::remove(folder / ("sem." + segment + "_mutex"), error);
    removed = fs::remove(lock, error) && !error && (removed || !fs::exists(folder / segment));
    ++(removed ? result.removed : result.refused);
  }
  return result;
}

}  // namespace secondskin::bus
