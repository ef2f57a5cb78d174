#pragma once

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <toml++/toml.h>

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>

/// What the tactile stage's files share: body maps, learners' profiles, safe ranges, exposure.
/// Start-up only. Not part of the public interface.
namespace secondskin::coach {

/// @throws std::runtime_error naming file, line and what is wrong.
inline toml::table read_toml(const std::filesystem::path& file) {
  try {
    return toml::parse_file(file.string());
  } catch (const toml::parse_error& error) {
    throw std::runtime_error(
        fmt::format("{}:{}: {}", file.string(), error.source().begin.line, error.description()));
  }
}

/// Reads fields of one table; what is wrong throws naming file, line, field and what was expected.
class FieldReader {
 public:
  FieldReader(const std::filesystem::path& file, const toml::table& table)
      : file_(file), table_(table) {}

  [[noreturn]] void fail(std::string_view field, std::string_view expected) const {
    const toml::node* node = table_.get(field);
    const auto line = (node ? node->source() : table_.source()).begin.line;
    throw std::runtime_error(fmt::format("{}:{}: {}: {}expected {}", file_.string(), line, field,
                                         node ? "" : "missing, ", expected));
  }

  void allow(std::initializer_list<std::string_view> known) const {
    for (const auto& [key, node] : table_) {
      if (std::find(known.begin(), known.end(), key.str()) != known.end()) continue;
      throw std::runtime_error(fmt::format("{}:{}: {}: unknown, expected one of {}", file_.string(),
                                           key.source().begin.line, key.str(),
                                           fmt::join(known, ", ")));
    }
  }

  std::string text(std::string_view field, std::string_view expected) const {
    const auto value = table_[field].value_exact<std::string>();
    if (!value || value->empty()) fail(field, expected);
    return *value;
  }

  bool has(std::string_view field) const { return table_.contains(field); }

  double number(std::string_view field, double low, double high) const {
    const toml::node* node = table_.get(field);
    const auto value = node && node->is_number() ? node->value<double>() : std::nullopt;
    if (!value || !(*value >= low && *value <= high)) {
      fail(field, fmt::format("a number from {} to {}", low, high));
    }
    return *value;
  }

  /// [least, most]
  std::pair<double, double> range(std::string_view field, double low, double high) const {
    const std::string expected =
        fmt::format("two numbers from {} to {}, the least first", low, high);
    const toml::array* pair = table_[field].as_array();
    if (pair == nullptr || pair->size() != 2) fail(field, expected);
    std::pair<double, double> ends;
    for (std::size_t i = 0; i < 2; ++i) {
      if (!(*pair)[i].is_number()) fail(field, expected);
      (i == 0 ? ends.first : ends.second) = (*pair)[i].value_or(low - 1.0);
    }
    if (!(ends.first >= low && ends.first < ends.second && ends.second <= high)) {
      fail(field, expected);
    }
    return ends;
  }

  std::size_t whole(std::string_view field, std::int64_t low, std::int64_t high) const {
    const auto value = table_[field].value_exact<std::int64_t>();
    if (!value || *value < low || *value > high) {
      fail(field, fmt::format("a whole number from {} to {}", low, high));
    }
    return static_cast<std::size_t>(*value);
  }

 private:
  const std::filesystem::path& file_;
  const toml::table& table_;
};

/// The tables of an array such as [[tactor]], each for `use`; none if the array is missing.
/// @throws std::runtime_error unless it is an array of tables
template <class Use>
void for_each_table(const std::filesystem::path& file, const toml::table& parent,
                    std::string_view name, Use use) {
  if (!parent.contains(name)) return;
  const toml::array* array = parent[name].as_array();
  const std::string expected = fmt::format("[[{}]] tables", name);
  if (array == nullptr) FieldReader(file, parent).fail(name, expected);
  for (const toml::node& node : *array) {
    if (node.as_table() == nullptr) FieldReader(file, parent).fail(name, expected);
    use(*node.as_table());
  }
}

}  // namespace secondskin::coach
