# Rewrites the contract into what another vendor's compiler needs to meet ROS 2's names on the wire:
# types in a module dds_ and with a trailing underscore. Types of the contract are found, not listed.
file(READ ${IN} text)
string(REGEX MATCHALL "(struct|enum) [A-Za-z0-9]+" declared "${text}")
foreach(declaration IN LISTS declared)
  string(REGEX REPLACE "^(struct|enum) " "" type "${declaration}")
  string(REGEX REPLACE "([^A-Za-z0-9_\"])${type}([^A-Za-z0-9_])" "\\1${type}_\\2" text "${text}")
endforeach()
string(REPLACE "module msg {" "module msg { module dds_ {" text "${text}")
string(REGEX REPLACE "};[\n ]*};[\n ]*$" "}; }; };\n" text "${text}")
file(WRITE ${OUT} "${text}")
