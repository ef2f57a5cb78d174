#include "clients/history/profiles.h"

#include <fmt/format.h>

#include <stdexcept>

namespace secondskin::history {
namespace {

namespace fs = std::filesystem;

// An id that another program gave may hold anything.
bool is_plain(const std::string& learner) {
  return !learner.empty() && learner.front() != '.' &&
         learner.find_first_of(std::string_view("/\\\0", 3)) == learner.npos;
}

}  // namespace

fs::path profile_of(const fs::path& folder, const std::string& learner) {
  if (!is_plain(learner)) {
    throw std::runtime_error(fmt::format(
        "learner '{:.64}': expected an id without '/', that begins with no dot", learner));
  }
  return folder / (learner + ".toml");
}

std::vector<std::string> remove_profile(const fs::path& folder, const std::string& learner) {
  std::vector<std::string> removed;
  if (!is_plain(learner)) return removed;
  for (const char* kind : {".toml", ".exposure.toml", ".toml.partial", ".exposure.toml.partial"}) {
    const std::string name = learner + kind;
    if (fs::remove(folder / name)) removed.push_back(name);
  }
  return removed;
}

}  // namespace secondskin::history
