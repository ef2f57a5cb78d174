#include "server/markers/marker_set.h"

#include <fmt/format.h>

#include <toml++/toml.h>
#include <algorithm>
#include <cctype>
#include <cmath>
#include <initializer_list>
#include <set>
#include <stdexcept>
#include <string_view>

namespace secondskin::server {
namespace {

constexpr std::array<std::pair<std::string_view, Landmark>, 5> kLandmarks{{
    {"left_anterior_iliac_spine", Landmark::kLeftAnteriorIliacSpine},
    {"right_anterior_iliac_spine", Landmark::kRightAnteriorIliacSpine},
    {"left_posterior_iliac_spine", Landmark::kLeftPosteriorIliacSpine},
    {"right_posterior_iliac_spine", Landmark::kRightPosteriorIliacSpine},
    {"sacrum", Landmark::kSacrum},
}};

Landmark mirrored(Landmark landmark) {
  switch (landmark) {
    case Landmark::kLeftAnteriorIliacSpine:
      return Landmark::kRightAnteriorIliacSpine;
    case Landmark::kRightAnteriorIliacSpine:
      return Landmark::kLeftAnteriorIliacSpine;
    case Landmark::kLeftPosteriorIliacSpine:
      return Landmark::kRightPosteriorIliacSpine;
    case Landmark::kRightPosteriorIliacSpine:
      return Landmark::kLeftPosteriorIliacSpine;
    default:
      return landmark;
  }
}

// Upper case, without a subject's prefix: "Derrick:lfhd" is LFHD.
std::string plain(std::string_view name) {
  const std::size_t colon = name.rfind(':');
  if (colon != std::string_view::npos) name.remove_prefix(colon + 1);
  std::string result(name);
  for (char& c : result) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  return result;
}

MarkerPlace mirrored(const MarkerPlace& place, std::vector<std::string> names) {
  MarkerPlace other = place;
  other.names = std::move(names);
  other.segment = secondskin::mirrored(place.segment);
  other.p_BM.y() = -place.p_BM.y();
  other.landmark = mirrored(place.landmark);
  return other;
}

// One file being read; errors name it and the line.
struct File {
  std::filesystem::path path;

  [[noreturn]] void fail(const toml::node& where, std::string_view what) const {
    throw std::runtime_error(
        fmt::format("{}:{}: {}", path.string(), where.source().begin.line, what));
  }

  void check_fields(const toml::table& table, std::initializer_list<std::string_view> known) const {
    for (const auto& [key, value] : table) {
      if (std::find(known.begin(), known.end(), key.str()) == known.end()) {
        fail(value, fmt::format("unknown field \"{}\"; expected one of {}", key.str(),
                                fmt::join(known, ", ")));
      }
    }
  }

  std::vector<std::string> names(const toml::table& table, std::string_view field) const {
    const toml::node* node = table.get(field);
    std::vector<std::string> result;
    const auto add = [&](const toml::node& one) {
      const auto name = one.value<std::string>();
      if (!one.is_string() || name->empty()) {
        fail(one, fmt::format("{}: expected a marker's name or a list of names", field));
      }
      result.push_back(*name);
    };
    if (node == nullptr) return result;
    if (const toml::array* list = node->as_array()) {
      for (const toml::node& one : *list) add(one);
    } else {
      add(*node);
    }
    return result;
  }

  double number(const toml::node& node, std::string_view field, double least, double most) const {
    const auto value = node.value<double>();
    if (!node.is_number() || !(*value >= least && *value <= most)) {
      fail(node, fmt::format("{}: expected a number of metres from {} to {}", field, least, most));
    }
    return *value;
  }

  // Three numbers, or one for all three axes where `single` allows it.
  Eigen::Vector3d vector(const toml::node& node, std::string_view field, double least, double most,
                         bool single) const {
    if (single && node.is_number()) {
      return Eigen::Vector3d::Constant(number(node, field, least, most));
    }
    const toml::array* list = node.as_array();
    if (list == nullptr || list->size() != 3) {
      fail(node,
           fmt::format("{}: expected {}[x, y, z] in metres", field, single ? "a number or " : ""));
    }
    Eigen::Vector3d v;
    for (std::size_t i = 0; i < 3; ++i) {
      v[static_cast<Eigen::Index>(i)] = number((*list)[i], field, least, most);
    }
    return v;
  }
};

}  // namespace

MarkerSet::MarkerSet(std::string name, Skeleton nominal, std::vector<MarkerPlace> places)
    : name_(std::move(name)), nominal_(std::move(nominal)), places_(std::move(places)) {
  if (!is_canonical(nominal_)) {
    throw std::invalid_argument("a marker set's nominal body must have the canonical joints");
  }
  std::set<std::string> used;
  for (const MarkerPlace& place : places_) {
    if (place.names.empty()) throw std::invalid_argument("a marker of a set needs a name");
    for (const std::string& n : place.names) {
      if (!used.insert(plain(n)).second) {
        throw std::invalid_argument(fmt::format("marker \"{}\" is named twice in the set", n));
      }
    }
  }
}

MarkerSet MarkerSet::load(const std::filesystem::path& path) {
  const File file{path};
  toml::table table;
  try {
    table = toml::parse_file(path.string());
  } catch (const toml::parse_error& error) {
    throw std::runtime_error(
        fmt::format("{}:{}: {}", path.string(), error.source().begin.line, error.description()));
  }
  file.check_fields(table, {"name", "stature", "marker"});
  const toml::node* stature = table.get("stature");
  if (stature == nullptr) file.fail(table, "stature: expected the nominal body's height in metres");
  const double height = file.number(*stature, "stature", 0.5, 2.5);
  const toml::array* markers = table["marker"].as_array();
  if (markers == nullptr || markers->empty()) file.fail(table, "expected tables [[marker]]");
  std::vector<MarkerPlace> places;
  std::set<std::string> used;
  for (const toml::node& node : *markers) {
    const toml::table* entry = node.as_table();
    if (entry == nullptr) file.fail(node, "marker: expected a table");
    file.check_fields(*entry, {"names", "mirror", "segment", "at", "spread", "sway", "landmark"});
    MarkerPlace place;
    place.names = file.names(*entry, "names");
    if (place.names.empty()) file.fail(node, "names: expected a marker's name or a list of names");
    const auto segment = (*entry)["segment"].value<std::string>();
    const auto joint = segment ? find_joint(*segment) : std::nullopt;
    if (!joint) {
      file.fail(segment ? *entry->get("segment") : node,
                fmt::format("segment of {}: expected a canonical joint's name, e.g. \"left_knee\"",
                            place.names[0]));
    }
    place.segment = *joint;
    const toml::node* at = entry->get("at");
    if (at == nullptr) file.fail(node, fmt::format("at of {}: expected [x, y, z]", place.names[0]));
    place.p_BM = file.vector(*at, "at", -1.0, 1.0, false);
    if (const toml::node* n = entry->get("spread")) {
      place.spread = file.vector(*n, "spread", 1e-4, 0.5, true);
    }
    if (const toml::node* n = entry->get("sway")) place.sway = file.number(*n, "sway", 1e-4, 0.1);
    if (const toml::node* n = entry->get("landmark")) {
      const auto text = n->value<std::string>();
      const auto* known = std::find_if(kLandmarks.begin(), kLandmarks.end(),
                                       [&](const auto& l) { return text && l.first == *text; });
      if (known == kLandmarks.end()) {
        file.fail(*n,
                  "landmark: expected left_ or right_ anterior_iliac_spine or "
                  "posterior_iliac_spine, or sacrum");
      }
      place.landmark = known->second;
    }
    std::vector<std::string> mirror = file.names(*entry, "mirror");
    const MarkerPlace first = place;
    places.push_back(std::move(place));
    if (!mirror.empty()) places.push_back(mirrored(first, std::move(mirror)));
    for (std::size_t i = places.size() - (entry->contains("mirror") ? 2 : 1); i < places.size();
         ++i) {
      for (const std::string& name : places[i].names) {
        if (!used.insert(plain(name)).second) {
          file.fail(node, fmt::format("\"{}\" is named twice", name));
        }
      }
    }
  }
  return MarkerSet(table["name"].value_or(path.stem().string()), canonical_skeleton(height),
                   std::move(places));
}

MarkerSet MarkerSet::choose(const std::filesystem::path& folder,
                            const std::vector<std::string>& names) {
  std::error_code error;
  std::set<std::filesystem::path> files;  // sorted, so that the choice does not depend on the disk
  for (std::filesystem::directory_iterator it(folder, error), end; !error && it != end;
       it.increment(error)) {
    if (it->path().extension() == ".toml") files.insert(it->path());
  }
  if (files.empty()) {
    throw std::runtime_error(fmt::format("{}: found no marker sets (*.toml)", folder.string()));
  }
  std::optional<MarkerSet> best;
  std::size_t most = kLeastMarkers - 1;
  for (const auto& file : files) {
    MarkerSet set = load(file);
    const auto match = set.match(names);
    std::size_t count = 0;
    std::set<Joint> segments;
    for (std::size_t i = 0; i < match.size(); ++i) {
      if (!match[i]) continue;
      ++count;
      segments.insert(set.places_[i].segment);
    }
    if (segments.size() >= 3 && count > most) {
      most = count;
      best = std::move(set);
    }
  }
  if (!best) {
    throw std::runtime_error(
        fmt::format("no marker set in {} knows at least {} of these markers on three segments: {}",
                    folder.string(), kLeastMarkers, fmt::join(names, ", ")));
  }
  return *std::move(best);
}

MarkerSet MarkerSet::from_suit(const Suit& suit, const Skeleton& nominal) {
  std::vector<MarkerPlace> places;
  for (const SuitDetector& detector : suit.detectors) {
    MarkerPlace place;
    place.names = {detector.name};
    place.segment = detector.segment;
    place.p_BM = skin_place(nominal, detector.segment, detector.along, detector.angle).p_BS;
    places.push_back(std::move(place));
  }
  return MarkerSet(suit.name, nominal, std::move(places));
}

std::vector<std::optional<std::size_t>> MarkerSet::match(
    const std::vector<std::string>& names) const {
  std::vector<std::string> plain_names;
  for (const std::string& name : names) plain_names.push_back(plain(name));
  std::vector<std::optional<std::size_t>> result(places_.size());
  for (std::size_t i = 0; i < places_.size(); ++i) {
    for (const std::string& name : places_[i].names) {
      const auto found = std::find(plain_names.begin(), plain_names.end(), plain(name));
      if (found == plain_names.end()) continue;
      result[i] = static_cast<std::size_t>(found - plain_names.begin());
      break;
    }
  }
  return result;
}

}  // namespace secondskin::server
