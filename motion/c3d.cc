#include "motion/c3d.h"

#include <fmt/format.h>

#include <algorithm>

#include "motion/c3d_format.h"

namespace secondskin {
namespace c3d {

bool equals_ignoring_case(std::string_view a, std::string_view b) noexcept {
  const auto upper = [](char c) { return c >= 'a' && c <= 'z' ? static_cast<char>(c - 32) : c; };
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [&](char x, char y) { return upper(x) == upper(y); });
}

double metres_per_unit(std::string_view unit) noexcept {
  if (unit.empty() || equals_ignoring_case(unit, "mm")) return 0.001;
  if (equals_ignoring_case(unit, "cm")) return 0.01;
  if (equals_ignoring_case(unit, "m")) return 1.0;
  if (equals_ignoring_case(unit, "in")) return 0.0254;
  if (equals_ignoring_case(unit, "ft")) return 0.3048;
  return 0.0;
}

std::string continued(std::string_view name, std::size_t part) {
  return part == 1 ? std::string(name) : fmt::format("{}{}", name, part);
}

}  // namespace c3d

std::vector<std::string> C3dParameter::strings() const {
  std::vector<std::string> result;
  const auto* text = std::get_if<std::string>(&values);
  if (text == nullptr) return result;
  const std::size_t length = dimensions.empty() ? 1 : dimensions.front();
  if (length == 0) return result;
  for (std::size_t at = 0; at + length <= text->size(); at += length) {
    std::string_view string = std::string_view(*text).substr(at, length);
    string = string.substr(0, string.find('\0'));
    while (!string.empty() && (string.back() == ' ' || string.back() == '\t')) {
      string.remove_suffix(1);
    }
    while (!string.empty() && string.front() == ' ') string.remove_prefix(1);
    result.emplace_back(string);
  }
  return result;
}

std::vector<double> C3dParameter::numbers() const {
  return std::visit(
      [](const auto& v) -> std::vector<double> {
        if constexpr (std::is_same_v<std::decay_t<decltype(v)>, std::string>) {
          return {};
        } else {
          return std::vector<double>(v.begin(), v.end());
        }
      },
      values);
}

const C3dParameter* C3dFile::find(std::string_view group, std::string_view name) const noexcept {
  for (const C3dGroup& g : groups) {
    if (!c3d::equals_ignoring_case(g.name, group)) continue;
    for (const C3dParameter& p : g.parameters) {
      if (c3d::equals_ignoring_case(p.name, name)) return &p;
    }
  }
  return nullptr;
}

void C3dFile::set(std::string_view group, C3dParameter parameter) {
  C3dGroup* place = nullptr;
  for (C3dGroup& g : groups) {
    if (!c3d::equals_ignoring_case(g.name, group)) continue;
    if (place == nullptr) place = &g;
    for (C3dParameter& p : g.parameters) {
      if (!c3d::equals_ignoring_case(p.name, parameter.name)) continue;
      p = std::move(parameter);
      return;
    }
  }
  if (place == nullptr) place = &groups.emplace_back(C3dGroup{.name = std::string(group)});
  place->parameters.push_back(std::move(parameter));
}

}  // namespace secondskin
