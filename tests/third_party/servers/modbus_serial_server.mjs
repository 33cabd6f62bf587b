// modbus-serial as a TCP server; arguments and output as of modbus_tk_server.py.
//   node modbus_serial_server.mjs tcp PORT UNIT REGISTERS
import { readFileSync } from "node:fs";
import modbus from "modbus-serial";

const [, , , port, unit, file] = process.argv;
const lines = readFileSync(file, "utf8").trim().split("\n");
const registers = new Map(lines.map((line) => line.split(" ").map(Number)));

const server = new modbus.ServerTCP(
  {
    getHoldingRegister: (address, _unit, callback) =>
      registers.has(address)
        ? callback(null, registers.get(address))
        : callback({ modbusErrorCode: 2, msg: "no such register" }),
    setRegister: (address, value, _unit, callback) => {
      registers.set(address, value);
      console.log("wrote", address, value);
      callback(null);
    },
  },
  { host: "127.0.0.1", port: Number(port), unitID: Number(unit) },
);
server.on("initialized", () => console.log("listening"));
