#include "clients/authoring/save.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>
#include <stdexcept>
#include <system_error>

#include "coach/reference.h"
#include "motion/bvh.h"
#include "motion/whole_file.h"

namespace secondskin::authoring {

namespace fs = std::filesystem;

namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr std::size_t kLongestText = 512;  // a description on the bus

// JSON's strings are TOML's basic strings, but for DEL.
std::string toml_string(const std::string& text, const char* field) {
  if (text.size() > kLongestText) {
    throw std::invalid_argument(
        fmt::format("{}: expected at most {} bytes, got {}", field, kLongestText, text.size()));
  }
  if (text.find('\x7f') != std::string::npos) {
    throw std::invalid_argument(fmt::format("{}: expected no control characters", field));
  }
  try {
    return nlohmann::json(text).dump();
  } catch (const nlohmann::json::exception&) {
    throw std::invalid_argument(fmt::format("{}: expected UTF-8", field));
  }
}

// The most frequent value is the default, the others by name.
std::string section(const char* name, const ByJoint& values) {
  const auto most = std::max_element(values.begin(), values.end(), [&](double a, double b) {
    return std::count(values.begin(), values.end(), a) <
           std::count(values.begin(), values.end(), b);
  });
  std::string text = fmt::format("\n[{}]\ndefault = {:.10g}\n", name, *most);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    if (values[j] != *most) {
      text += fmt::format("{} = {:.10g}\n", joint_name(static_cast<Joint>(j)), values[j]);
    }
  }
  return text;
}

void require_folder_name(const std::string& name) {
  const bool plain = !name.empty() && name.size() <= 64 && name.front() != '.' &&
                     name.find('/') == std::string::npos && name.find('\0') == std::string::npos;
  if (!plain) {
    throw std::invalid_argument(fmt::format(
        "name '{:.64}': expected 1 to 64 characters, no '/', not beginning with '.'", name));
  }
}

void require_joints(const Recipe& recipe) {
  bool any = false;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const auto name = joint_name(static_cast<Joint>(j));
    // Written so that NaN is refused.
    if (!(recipe.weight[j] >= 0.0 && recipe.weight[j] <= 1.0)) {
      throw std::invalid_argument(fmt::format("joints.{}.weight: expected 0 to 1", name));
    }
    const double degrees = recipe.tolerance[j] / kDegree;
    if (!(degrees >= 0.1 - 1e-9 && degrees <= 180.0 + 1e-9)) {
      throw std::invalid_argument(
          fmt::format("joints.{}.tolerance_deg: expected 0.1 to 180", name));
    }
    any = any || recipe.weight[j] > 0.0;
  }
  if (!any) throw std::invalid_argument("joints: expected at least one weight above 0");
}

}  // namespace

Recipe plain_recipe(std::string name, std::vector<Motion> performances) {
  Recipe recipe{.name = std::move(name),
                .description = {},
                .origin = {},
                .performances = std::move(performances),
                .weight = {},
                .tolerance = {}};
  recipe.weight.fill(1.0);
  recipe.tolerance.fill(coach::kDefaultTolerance_deg * kDegree);
  return recipe;
}

void require_reference_name(const std::string& name) {
  const bool plain = !name.empty() && name.size() <= 64 &&
                     std::isalnum(static_cast<unsigned char>(name[0])) &&
                     std::all_of(name.begin(), name.end(), [](unsigned char c) {
                       return c < 0x80 && (std::isalnum(c) != 0 || c == '_' || c == '-');
                     });
  if (!plain) {
    throw std::invalid_argument(fmt::format(
        "name '{:.64}': expected 1 to 64 letters, digits, '_' and '-', a letter or digit first",
        name));
  }
}

fs::path save_reference(const Recipe& recipe, const fs::path& references,
                        const fs::path& joint_maps) {
  require_folder_name(recipe.name);
  require_joints(recipe);
  if (recipe.performances.empty()) throw std::invalid_argument("parts: expected at least one");
  const fs::path folder = references / recipe.name;
  const auto taken = [&] {
    return std::invalid_argument(fmt::format(
        "name '{}': a reference of this name exists already; choose another", recipe.name));
  };
  if (fs::exists(folder)) throw taken();
  ByJoint degrees;
  for (std::size_t j = 0; j < kJointCount; ++j) degrees[j] = recipe.tolerance[j] / kDegree;
  const std::string toml =
      fmt::format(
          "# Which joints matter and how exactly. See docs/user-guide.md.\n"
          "name = {}\ndescription = {}\norigin = {}\nlicence = {}\nstanding = {}\n",
          toml_string(recipe.name, "name"), toml_string(recipe.description, "description"),
          toml_string(recipe.origin, "origin"), toml_string(recipe.licence, "licence"),
          recipe.standing) +
      section("weights", recipe.weight) + section("tolerances_deg", degrees);

  // Made under a name that is none, and renamed, so that no half reference is ever seen.
  const fs::path part = references / ("." + recipe.name + ".part");
  try {
    fs::remove_all(part);
    fs::create_directories(part);
    for (std::size_t i = 0; i < recipe.performances.size(); ++i) {
      // The same number of digits keeps the order of their names.
      const int digits = recipe.performances.size() < 10 ? 1 : 3;
      const std::string file =
          i == 0 ? std::string("motion.bvh") : fmt::format("expert_{:0{}}.bvh", i + 1, digits);
      write_bvh(recipe.performances[i], part / file);
    }
    write_whole_file(part / "motion.toml", toml);
    coach::load_reference(part, joint_maps);
    std::error_code error;
    fs::rename(part, folder, error);
    if (error && fs::exists(folder)) throw taken();  // by somebody else, meanwhile
    if (error) throw std::system_error(error, folder.string() + ": cannot be made");
  } catch (...) {
    std::error_code ignored;
    fs::remove_all(part, ignored);
    throw;
  }
  return folder;
}

}  // namespace secondskin::authoring
