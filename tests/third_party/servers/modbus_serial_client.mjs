// modbus-serial as a client of Modbus UDP or TCP: waits for the flag, prints registers 300-326,
// clears the flag by FC 6, prints them again, and says how a read of register 400 is refused.
//   node modbus_serial_client.mjs (tcp | udp) PORT UNIT
import modbus from "modbus-serial";

const [, , kind, port, unit] = process.argv;
const client = new modbus();
const connect = kind === "udp" ? client.connectUDP : client.connectTCP;
await connect.call(client, "127.0.0.1", { port: Number(port) });
while (!client.isOpen) await new Promise(setImmediate);
client.setID(Number(unit));
client.setTimeout(2000);
let block;
do block = (await client.readHoldingRegisters(300, 27)).data;
while (block[0] !== 1);
console.log(block.join(" "));
const echo = await client.writeRegister(300, 0);
console.log(echo.address, echo.value);
console.log((await client.readHoldingRegisters(300, 27)).data.join(" "));
console.log(await client.readHoldingRegisters(400, 1).then(String, (error) => error.modbusCode));
client.close(() => process.exit(0));
