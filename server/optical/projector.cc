#include "server/optical/projector.h"

#include <fmt/format.h>

#include <cerrno>
#include <cmath>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <system_error>

namespace secondskin::server {
namespace {

// The format's limit: a slot a projector, 255 at most as in wire::TagFormat.
constexpr std::size_t kMostProjectors = 255;

[[noreturn]] void fail(const std::filesystem::path& file, std::size_t line,
                       const std::string& why) {
  throw std::runtime_error(fmt::format("{}:{}: {}", file.string(), line, why));
}

}  // namespace

ProjectorRig ProjectorRig::load(const std::filesystem::path& file) {
  std::ifstream in(file);
  if (!in) {
    throw std::runtime_error(fmt::format(
        "{}: cannot be opened; expected a projector calibration, which 'secondskin calibrate "
        "optical' writes",
        file.string()));
  }
  ProjectorRig rig;
  bool sized = false;
  std::string text;
  for (std::size_t line = 1; std::getline(in, text); ++line) {
    if (const auto comment = text.find('#'); comment != std::string::npos) text.erase(comment);
    std::istringstream fields(text);
    std::string first;
    if (!(fields >> first)) continue;
    if (!sized) {
      std::size_t n = 0;
      if (first != "projectors" || !(fields >> n) || n < 1 || n > kMostProjectors) {
        fail(file, line, "expected 'projectors N' with N from 1 to 255");
      }
      rig.projectors.resize(n);
      sized = true;
      continue;
    }
    std::istringstream again(text);
    long slot = -1;
    if (!(again >> slot) || slot < 0 || static_cast<std::size_t>(slot) >= rig.size()) {
      fail(file, line,
           fmt::format("expected a slot from 0 to {}, found '{}'", rig.size() - 1, first));
    }
    auto& place = rig.projectors[static_cast<std::size_t>(slot)];
    if (place) fail(file, line, fmt::format("projector {} stands here a second time", slot));
    Projector projector;
    projector.P(1, 3) = 1.0;
    for (int i = 0; i < 7; ++i) {
      std::string number;
      double value = NAN;
      if (again >> number) {
        char* end = nullptr;
        value = std::strtod(number.c_str(), &end);
        if (*end != '\0') value = NAN;
      }
      if (!std::isfinite(value)) {
        fail(file, line,
             fmt::format("projector {}: expected seven finite numbers, found '{}' as the {}.", slot,
                         number, i + 1));
      }
      projector.P(i / 4, i % 4) = value;
    }
    std::string more;
    if (again >> more) {
      fail(file, line,
           fmt::format("projector {}: expected seven numbers, found '{}' after them", slot, more));
    }
    place = projector;
  }
  if (!sized)
    throw std::runtime_error(
        fmt::format("{}: expected 'projectors N', found the end", file.string()));
  return rig;
}

void ProjectorRig::save(const std::filesystem::path& file) const {
  auto temporary = file;
  temporary += ".part";
  const auto give_up = [&] {
    const int error = errno;
    std::error_code ignored;
    std::filesystem::remove(temporary, ignored);
    throw std::system_error(error != 0 ? error : EIO, std::generic_category(), file.string());
  };
  {
    errno = 0;
    std::ofstream out(temporary);
    out << "# Projector calibration: slot, then P11 P12 P13 P14 P21 P22 P23 of\n"
           "# h [v 1] = P [x y z 1], P24 = 1; metres, z up, v in counts (Second Skin, 2.2.2).\n"
        << "projectors " << size() << '\n';
    for (std::size_t i = 0; i < size(); ++i) {
      if (!projectors[i]) continue;
      out << i;
      for (int k = 0; k < 7; ++k) out << fmt::format(" {}", projectors[i]->P(k / 4, k % 4));
      out << '\n';
    }
    out.flush();
    if (!out) give_up();
  }
  std::error_code error;
  std::filesystem::rename(temporary, file, error);
  if (error) {
    errno = error.value();
    give_up();
  }
}

}  // namespace secondskin::server
