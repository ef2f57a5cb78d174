#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "clients/authoring/take.h"
#include "clients/authoring/take_recorder.h"
#include "clients/dashboard/http.h"
#include "coach/reference.h"

/// Recording references over HTTP: /api/takes... docs/references.md lists the requests.
namespace secondskin::authoring {

struct TakesApi {
  std::shared_ptr<TakeStore> takes;
  std::shared_ptr<TakeRecorder> recorder;
  /// A motion file's poses. Throws std::runtime_error that names the file.
  std::function<Motion(const std::filesystem::path& file)> import;
  std::filesystem::path joint_maps;
  std::filesystem::path own;  ///< the folder of the user's own references
  std::function<std::vector<std::filesystem::path>()> references;  ///< all references' folders
};

/// One call at a time.
dashboard::HttpHandler takes_api(TakesApi api);

/// The largest file that can be imported [bytes].
inline constexpr std::size_t kLargestImport = 32u << 20;

}  // namespace secondskin::authoring
