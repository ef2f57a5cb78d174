#include "motion/suit.h"

#include <fmt/format.h>

#include <toml++/toml.h>
#include <algorithm>
#include <cmath>
#include <set>
#include <stdexcept>
#include <string_view>

namespace secondskin {
namespace {

constexpr std::size_t kInputs = 18;  // Second Skin, 2.1.3: wire::kDetectorsOnATag

class SuitReader {
 public:
  explicit SuitReader(const std::filesystem::path& file) : file_(file) {}

  Suit read() const {
    toml::table table;
    try {
      table = toml::parse_file(file_.string());
    } catch (const toml::parse_error& error) {
      fail(error.source(), error.description());
    }
    Suit suit;
    allow_only(table, {"name", "detector"});
    suit.name = text(table, "name");
    const toml::array* list = table["detector"].as_array();
    if (list == nullptr || list->empty()) fail(table.source(), "no [[detector]]");
    std::set<std::string> names;
    std::set<std::pair<std::size_t, std::size_t>> plugs;
    for (const toml::node& node : *list) {
      const toml::table* entry = node.as_table();
      if (entry == nullptr) fail(node.source(), "expected [[detector]]");
      SuitDetector detector = read_detector(*entry);
      if (!names.insert(detector.name).second) {
        fail(entry->get("name")->source(), fmt::format("name: \"{}\" is doubled", detector.name));
      }
      if (!plugs.emplace(detector.tag, detector.input).second) {
        fail(entry->get("input")->source(),
             fmt::format("input: {} of tag {} is doubled", detector.input, detector.tag));
      }
      suit.detectors.push_back(std::move(detector));
    }
    // The sets of a tag have one value after the other: an input that nothing is plugged into
    // would shift all that follow.
    std::pair<std::size_t, std::size_t> next{0, 0};
    for (const auto& plug : plugs) {
      if (plug.first == next.first + 1 && plug.second == 0 && next.second > 0) next = plug;
      if (plug != next) {
        fail(table.source(),
             fmt::format("tag {} input {} has no detector; tags and the inputs of a tag are used "
                         "from 0 without a gap",
                         plug.first == next.first ? next.first : next.first + (next.second > 0),
                         plug.first == next.first ? next.second : 0));
      }
      ++next.second;
    }
    std::sort(suit.detectors.begin(), suit.detectors.end(),
              [](const SuitDetector& a, const SuitDetector& b) {
                return std::pair(a.tag, a.input) < std::pair(b.tag, b.input);
              });
    return suit;
  }

 private:
  [[noreturn]] void fail(const toml::source_region& where, std::string_view what) const {
    throw std::runtime_error(fmt::format("{}:{}: {}", file_.string(), where.begin.line, what));
  }

  void allow_only(const toml::table& table, std::initializer_list<std::string_view> keys) const {
    for (const auto& [key, value] : table) {
      if (std::find(keys.begin(), keys.end(), key.str()) == keys.end()) {
        fail(key.source(), fmt::format("\"{}\" is no field of a suit", key.str()));
      }
    }
  }

  const toml::node& field(const toml::table& table, std::string_view key) const {
    const toml::node* node = table.get(key);
    if (node == nullptr) fail(table.source(), fmt::format("no {}", key));
    return *node;
  }

  std::string text(const toml::table& table, std::string_view key) const {
    const toml::node& node = field(table, key);
    const auto value = node.is_string() ? node.value<std::string>() : std::nullopt;
    if (!value || value->empty()) fail(node.source(), fmt::format("{}: expected a text", key));
    return *value;
  }

  std::size_t count(const toml::table& table, std::string_view key, std::size_t most) const {
    const toml::node& node = field(table, key);
    const auto value = node.is_integer() ? node.value<std::int64_t>() : std::nullopt;
    if (!value || *value < 0 || *value > static_cast<std::int64_t>(most)) {
      fail(node.source(), fmt::format("{}: expected a whole number from 0 to {}", key, most));
    }
    return static_cast<std::size_t>(*value);
  }

  double number(const toml::table& table, std::string_view key, double min, double max) const {
    const toml::node& node = field(table, key);
    const auto value = node.is_number() ? node.value<double>() : std::nullopt;
    // Written so that NaN is refused.
    if (!value || !(*value >= min && *value <= max)) {
      fail(node.source(), fmt::format("{}: expected a number from {} to {}", key, min, max));
    }
    return *value;
  }

  SuitDetector read_detector(const toml::table& entry) const {
    allow_only(entry, {"name", "tag", "input", "segment", "along", "angle_deg"});
    constexpr std::size_t kMostTags = 255;
    SuitDetector detector;
    detector.name = text(entry, "name");
    detector.tag = count(entry, "tag", kMostTags);
    detector.input = count(entry, "input", kInputs - 1);
    const std::string segment = text(entry, "segment");
    const auto joint = find_joint(segment);
    if (!joint) {
      fail(entry.get("segment")->source(),
           fmt::format("segment: \"{}\" is no canonical joint", segment));
    }
    detector.segment = *joint;
    detector.along = number(entry, "along", 0.0, 1.0);
    detector.angle = number(entry, "angle_deg", -360.0, 360.0) * std::numbers::pi / 180.0;
    return detector;
  }

  std::filesystem::path file_;
};

}  // namespace

Suit Suit::load(const std::filesystem::path& file) { return SuitReader(file).read(); }

std::size_t Suit::tags() const noexcept { return detectors.empty() ? 0 : detectors.back().tag + 1; }

std::size_t Suit::detectors_of(std::size_t tag) const noexcept {
  return static_cast<std::size_t>(
      std::count_if(detectors.begin(), detectors.end(),
                    [tag](const SuitDetector& detector) { return detector.tag == tag; }));
}

}  // namespace secondskin
