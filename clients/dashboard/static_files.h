#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>

/// Requests' targets, and the built page that they ask for.
namespace secondskin::dashboard {

struct Target {
  std::string path;                          ///< decoded
  std::map<std::string, std::string> query;  ///< decoded; of equal names the last
};

/// @returns nothing when the target does not begin with '/' or an escape is not two hex digits.
std::optional<Target> parse_target(std::string_view target);

/// A file as it is served.
struct StaticFile {
  std::string content_type;
  std::string etag;
  std::string body;
  bool immutable = false;  ///< its name changes with its content
};

/// The built page: a folder that is read as asked, so that a new build shows at once.
class StaticFiles {
 public:
  explicit StaticFiles(std::filesystem::path folder) : folder_(std::move(folder)) {}

  /// "/" is index.html. Nothing outside the folder is ever read, links that lead out included.
  /// @returns nothing where there is no such file.
  std::optional<StaticFile> find(std::string_view path) const;

  /// Whether the page was built.
  bool built() const { return find("/").has_value(); }
  /// Changes with the page.
  std::string version() const;

 private:
  std::filesystem::path folder_;
};

}  // namespace secondskin::dashboard
