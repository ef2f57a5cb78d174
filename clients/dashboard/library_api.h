#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "clients/dashboard/http.h"
#include "coach/plan/session_plan.h"
#include "coach/reference.h"

/// GET /api/info, /api/plans, /api/body_maps and /api/references/NAME: what the page must know of
/// the files that come with the program.
namespace secondskin::dashboard {

struct LibraryApi {
  std::string subject, version;
  std::function<std::string()> page_version;
  bool history = false;  ///< whether /api/history is served
  std::function<std::vector<coach::SessionPlan>()> plans;
  std::function<std::vector<std::string>()> body_maps;  ///< by name
  /// By name. Throws std::runtime_error that lists the names when there is none.
  std::function<std::shared_ptr<const coach::Reference>(const std::string& name)> reference;
};

HttpHandler handler(LibraryApi api);

}  // namespace secondskin::dashboard
