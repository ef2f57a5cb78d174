#pragma once

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <toml++/toml.h>

#include <Eigen/Core>
#include <algorithm>
#include <filesystem>
#include <initializer_list>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>

#include "motion/anatomy.h"

/// Reads the product's own TOML files so that what is wrong is named by file, line and field. For
/// the readers' .cc files only: it needs toml++ and fmt.
namespace secondskin {

/// Parses a file. @throws std::runtime_error naming file and line, or that it cannot be read.
inline toml::table parse_toml(const std::filesystem::path& file) {
  try {
    return toml::parse_file(file.string());
  } catch (const toml::parse_error& error) {
    throw std::runtime_error(
        fmt::format("{}:{}: {}", file.string(), error.source().begin.line, error.description()));
  }
}

/// The fields of one table. Each reader throws std::runtime_error "FILE:LINE: FIELD: expected …".
class TomlFields {
 public:
  TomlFields(const std::filesystem::path& file, const toml::table& table)
      : file_(file), table_(table) {}

  const toml::table& table() const noexcept { return table_; }

  [[noreturn]] void fail(std::string_view field, std::string_view expected) const {
    const toml::node* node = table_.get(field);
    const auto line = (node != nullptr ? node->source() : table_.source()).begin.line;
    throw std::runtime_error(fmt::format("{}:{}: {}: {}expected {}", file_.string(), line, field,
                                         node != nullptr ? "" : "missing, ", expected));
  }

  /// Refuses any other field.
  void allow(std::initializer_list<std::string_view> known) const {
    for (const auto& [key, node] : table_) {
      if (std::find(known.begin(), known.end(), key.str()) != known.end()) continue;
      throw std::runtime_error(fmt::format("{}:{}: {}: unknown, expected one of {}", file_.string(),
                                           key.source().begin.line, key.str(),
                                           fmt::join(known, ", ")));
    }
  }

  std::string text(std::string_view field, std::string_view expected = "a text") const {
    const auto value = table_[field].value_exact<std::string>();
    if (!value || value->empty()) fail(field, expected);
    return *value;
  }

  bool has(std::string_view field) const { return table_.contains(field); }

  double number(std::string_view field, double low, double high) const {
    const toml::node* node = table_.get(field);
    const auto value = node != nullptr && node->is_number() ? node->value<double>() : std::nullopt;
    // Written so that NaN is refused.
    if (!value || !(*value >= low && *value <= high)) {
      fail(field, fmt::format("a number from {} to {}", low, high));
    }
    return *value;
  }

  std::size_t whole(std::string_view field, std::int64_t low, std::int64_t high) const {
    const auto value = table_[field].value_exact<std::int64_t>();
    if (!value || *value < low || *value > high) {
      fail(field, fmt::format("a whole number from {} to {}", low, high));
    }
    return static_cast<std::size_t>(*value);
  }

  bool flag(std::string_view field) const {
    const auto value = table_[field].value_exact<bool>();
    if (!value) fail(field, "true or false");
    return *value;
  }

  Joint joint(std::string_view field) const {
    const auto joint = find_joint(text(field, "a canonical joint's name"));
    if (!joint) fail(field, "a canonical joint's name");
    return *joint;
  }

  /// Two numbers, the lesser first.
  std::pair<double, double> range(std::string_view field, double low, double high) const {
    const auto expected = fmt::format("two numbers from {} to {}, the least first", low, high);
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

  /// Three numbers, each of at most `most` in size.
  Eigen::Vector3d vector(std::string_view field, double most) const {
    const toml::array* list = table_[field].as_array();
    const auto expected = fmt::format("three numbers from -{0} to {0}", most);
    if (list == nullptr || list->size() != 3) fail(field, expected);
    Eigen::Vector3d v;
    for (std::size_t i = 0; i < 3; ++i) {
      const auto value = (*list)[i].is_number() ? (*list)[i].value<double>() : std::nullopt;
      if (!value || !(std::abs(*value) <= most)) fail(field, expected);
      v[static_cast<Eigen::Index>(i)] = *value;
    }
    return v;
  }

  /// Calls `look` with the fields of each entry of [[field]]; there must be one at least.
  template <class Look>
  void each(std::string_view field, Look look) const {
    const toml::array* list = table_[field].as_array();
    const auto expected = fmt::format("one [[{}]] at least", field);
    if (list == nullptr || list->empty()) fail(field, expected);
    for (const toml::node& node : *list) {
      const toml::table* entry = node.as_table();
      if (entry == nullptr) fail(field, expected);
      look(TomlFields(file_, *entry));
    }
  }

 private:
  const std::filesystem::path& file_;
  const toml::table& table_;
};

}  // namespace secondskin
