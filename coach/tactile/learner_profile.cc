#include "coach/tactile/learner_profile.h"

#include <fmt/ostream.h>

#include <numeric>

#include "motion/toml_fields.h"
#include "motion/whole_file.h"

namespace secondskin::coach {
namespace {

std::uint32_t presentations(const SiteProfile& site) noexcept {
  return std::accumulate(site.named.begin(), site.named.end(), std::uint32_t{0});
}

}  // namespace

double recognition(const SiteProfile& site) noexcept {
  const std::uint32_t shown = presentations(site);
  return shown < kLeastPresentations ? 1.0 : static_cast<double>(site.named[site.channel]) / shown;
}

double confusion(const SiteProfile& a, const SiteProfile& b) noexcept {
  const std::uint32_t shown = presentations(a) + presentations(b);
  if (shown < 2 * kLeastPresentations) return 0.0;
  return static_cast<double>(a.named[b.channel] + b.named[a.channel]) / shown;
}

LearnerProfile LearnerProfile::load(const std::filesystem::path& file) {
  const toml::table table = parse_toml(file);
  const TomlFields in(file, table);
  in.allow({"body_map", "site"});
  LearnerProfile profile;
  profile.body_map = in.text("body_map", "the name of the body map that was calibrated");
  in.each("site", [&](const TomlFields& fields) {
    fields.allow({"channel", "threshold", "ceiling", "named"});
    SiteProfile site;
    site.channel = fields.whole("channel", 0, wire::kTactorCount - 1);
    for (const SiteProfile& other : profile.sites) {
      if (other.channel == site.channel) fields.fail("channel", "one that no other site has");
    }
    site.threshold = fields.number("threshold", 0.0, 1.0);
    site.ceiling = fields.number("ceiling", 0.0, 1.0);
    constexpr std::string_view kCounts = "sixteen counts, one for each channel";
    const toml::array* named = fields.table()["named"].as_array();
    if (named == nullptr || named->size() != site.named.size()) fields.fail("named", kCounts);
    for (std::size_t c = 0; c < site.named.size(); ++c) {
      const auto count = (*named)[c].value_exact<std::int64_t>();
      if (!count || *count < 0 || *count > 10'000) fields.fail("named", kCounts);
      site.named[c] = static_cast<std::uint32_t>(*count);
    }
    profile.sites.push_back(site);
  });
  return profile;
}

void LearnerProfile::save(const std::filesystem::path& file) const {
  std::string text = fmt::format(
      "# One learner's skin under the tactors of a body map, made by `secondskin calibrate "
      "tactors`.\n# named: how often each channel, 0 to 15, was named when this one vibrated.\n"
      "body_map = {}\n",
      fmt::streamed(toml::value<std::string>(body_map)));
  for (const SiteProfile& site : sites) {
    text += fmt::format("\n[[site]]\nchannel = {}\nthreshold = {}\nceiling = {}\nnamed = [{}]\n",
                        site.channel, site.threshold, site.ceiling, fmt::join(site.named, ", "));
  }
  if (file.has_parent_path()) std::filesystem::create_directories(file.parent_path());
  write_whole_file(file, text);
}

BodyMap LearnerProfile::shape(BodyMap map) const {
  if (map.name != body_map) {
    throw std::runtime_error(
        fmt::format("the learner's profile is of body map '{}', but the session uses '{}'",
                    body_map, map.name));
  }
  for (const SiteProfile& site : sites) {
    const auto tactor = std::find_if(map.tactors.begin(), map.tactors.end(),
                                     [&](const Tactor& t) { return t.channel == site.channel; });
    if (tactor == map.tactors.end()) {
      throw std::runtime_error(
          fmt::format("the learner's profile has channel {}, which body map '{}' does not",
                      site.channel, map.name));
    }
    tactor->threshold = site.threshold;
    tactor->ceiling = std::min(tactor->ceiling, site.ceiling);
    for (const SiteProfile& other : sites) {
      if (other.channel != site.channel && confusion(site, other) > kMostConfusion) {
        tactor->no_phantom_with |= static_cast<std::uint16_t>(1u << other.channel);
      }
    }
    if (tactor->threshold > tactor->ceiling || recognition(site) < kLeastRecognition) {
      map.tactors.erase(tactor);
    }
  }
  if (map.tactors.empty()) {
    throw std::runtime_error("the learner feels or recognises none of the body map's tactors");
  }
  return map;
}

}  // namespace secondskin::coach
