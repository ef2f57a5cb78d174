#include "clients/authoring/scratch.h"

#include <cerrno>
#include <cstdlib>
#include <string>
#include <system_error>

namespace secondskin::authoring {

namespace fs = std::filesystem;

Scratch::Scratch() {
  std::string name = (fs::temp_directory_path() / "secondskin-XXXXXX").string();
  if (::mkdtemp(name.data()) == nullptr) {
    throw std::system_error(errno, std::generic_category(), name + ": cannot be made");
  }
  folder_ = name;
}

Scratch::~Scratch() {
  std::error_code ignored;
  fs::remove_all(folder_, ignored);
}

}  // namespace secondskin::authoring
