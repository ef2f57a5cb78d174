#pragma once

#include <filesystem>
#include <functional>
#include <vector>

#include "clients/dashboard/http.h"

/// GET /api/references and /api/references/NAME/export. docs/references.md lists the requests.
namespace secondskin::authoring {

struct ReferencesApi {
  std::filesystem::path joint_maps;
  std::filesystem::path idl;  ///< idl/secondskin_msgs.idl
  std::filesystem::path own;  ///< the folder of the user's own references
  std::function<std::vector<std::filesystem::path>()> references;  ///< all references' folders
};

/// One call at a time.
dashboard::HttpHandler references_api(ReferencesApi api);

}  // namespace secondskin::authoring
